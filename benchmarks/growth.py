"""Growth of time and memory with the number of worlds, and with the number of episodes.

    python benchmarks/growth.py worlds [--steps 4]        # processor time and memory of a world
    python benchmarks/growth.py table [--rows 1000000]    # of a comparison's results

`worlds` steps environments with random actions and without resets (`benchmarks/resets.py` has these), beside raw
`mj_step` on as many worlds. `table` fills the folder of a comparison of the default policies with episodes that were
never played, of lengths as theirs and with a return of its own each; then `armctl.compare` resumes it and finds nothing
left to play, its episodes are read, and its report is written, without videos. Each figure is of a fresh process, its
start included.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from printing import show, versioned_table

from armctl.episodes.record import EpisodeResult
from armctl.episodes.store import Store
from armctl.episodes.stored import STORE, UNDISTURBED, read_store
from armctl.report.page import REPORT

REACH, BRIDGE = "armctl/ArmReach-v0", "armctl/BridgeCross-v0"

WORLDS = (64, 256, 1024, 4096)
ROUNDS = 3
PLAY = "import armctl; done = armctl.compare(env=env, episodes=int(episodes), out=folder)"
JOBS = {
    "summary": f"{PLAY}; assert done.resumed == len(done.results), done.failures",
    "read": "from armctl.episodes.stored import read_store; read_store(Path(folder))",
    "report": "from armctl.report import write_report; write_report(folder, video=False, env=env)",
}
"""Measured jobs, as Python."""
COST = """
_, _, peak = Path("/proc/self/status").read_text().partition("VmHWM:")
print(json.dumps({"seconds": time.process_time(), "peak": int(peak.split()[0])}))
"""
"""Processor time and largest memory, kB, of this process since it began: `ru_maxrss` has that of its parent as well."""
ENVS = Annotated[list[str], typer.Option("--env", help="Environments.")]

app = typer.Typer(help=__doc__, add_completion=False, pretty_exceptions_enable=False)


@app.command()
def worlds(steps: int = 4, env: ENVS = [REACH, BRIDGE], count: list[int] = list(WORLDS)) -> None:  # noqa: B006
    """Measure numbers of worlds, and print a table."""
    table = versioned_table("", "worlds", "us a world and step", "times raw `mj_step`", "kB a world")
    for name in env:
        for n in count:
            figures = _in_a_fresh_process("step", name, n, steps)
            table.add_row(
                f"`{name}`", f"{n:,}", f"{figures['us']:,.0f}", f"{figures['ratio']:.2f}", f"{figures['kb']:,.0f}"
            )
    show(table)


@app.command()
def table(rows: int = 1_000_000, env: ENVS = [REACH, BRIDGE]) -> None:  # noqa: B006
    """Measure the results of a comparison with so many episodes in all, and print a table."""
    output = versioned_table(
        "", "episodes", "decisions", "", "processor s", "peak MB", "s of 30 episodes", "MB of these", "MB on disk"
    )
    for name in env:
        with tempfile.TemporaryDirectory() as home:
            few, many = Path(home, "few"), Path(home, "many")
            for folder in (few, many):
                _cost(PLAY, name, folder, 1)
            started, filled = (_in_a_fresh_process("fill", *of) for of in ((few, 30), (many, rows)))
            counts = f"{filled['episodes']:,}", f"{filled['decisions'] / 1e6:.0f} M"
            for job, code in JOBS.items():
                start, figures = (
                    _cost(code, name, folder, to["episodes"] / to["policies"])
                    for folder, to in ((few, started), (many, filled))
                )
                written = {"summary": many.iterdir(), "read": [many / STORE], "report": [many / REPORT]}[job]
                output.add_row(
                    f"`{name}`", *counts, job, f"{figures['seconds']:.1f}", f"{figures['peak'] / 1e3:,.0f}",
                    f"{start['seconds']:.1f}", f"{start['peak'] / 1e3:,.0f}", f"{_size(*written):,.1f}",
                )  # fmt: skip
    show(output)


@app.command(hidden=True)
def step(env: str, n: int, steps: int) -> None:
    """Print processor time and memory of a world, in this process."""
    from relapse import stepped  # with libraries that no other command loads: they would count in its memory

    stepped(env, 1)[0](0)  # loads and compiles
    memory_before = _resident()
    ours, raw = stepped(env, n)
    ours(0)
    memory, times = _resident() - memory_before, []
    for _ in range(ROUNDS):
        row = []
        for work in (ours, raw):
            began = time.process_time()
            for i in range(steps):
                work(i)
            row.append((time.process_time() - began) / steps / n)
        times.append(row)
    ratio = np.median([seconds / reference for seconds, reference in times])
    print(json.dumps({"us": 1e6 * np.median(times, axis=0)[0], "ratio": ratio, "kb": memory / n / 1e3}))


@app.command(hidden=True)
def fill(folder: Path, rows: int) -> None:
    """Write episodes that look like the first ones, those of a comparison with one of each policy."""
    cell = read_store(folder).cells[UNDISTURBED]
    episodes, identity = [*cell.episodes], cell.identity
    each, decisions = rows // len(episodes), 0
    with Store(folder) as store:
        store.open(identity["seed"], [UNDISTURBED])
        log = store.cell(UNDISTURBED, identity, each)
        for first in episodes:
            decisions += first.length
            for result in _others(first, each):
                decisions += result.length
                log.write(result)
    print(json.dumps({"episodes": each * len(episodes), "decisions": decisions, "policies": len(episodes)}))


def _others(first: EpisodeResult, episodes: int) -> Iterator[EpisodeResult]:
    rng = np.random.default_rng(len(first.policy))
    measured = [
        name for name, value in vars(first.metrics).items() if isinstance(value, float) and name != "first_call_ms"
    ]
    for k in range(1, episodes):
        length = int(rng.integers(max(2, first.length // 2), first.length + 1))
        noise = 1 + 0.1 * rng.standard_normal(len(measured))
        values = [factor * getattr(first.metrics, name) for factor, name in zip(noise, measured, strict=True)]
        metrics = replace(first.metrics, **dict(zip(measured, values, strict=True)), first_call_ms=np.nan)
        decision_ms = np.round(rng.lognormal(np.log(metrics.decision_ms_p50), 0.5, length), 4)
        won = bool(first.success and rng.random() < 0.95)
        yield replace(
            first, episode=k, success=won, total_reward=first.total_reward * rng.uniform(0.9, 1.0), length=length,
            metrics=metrics, decision_ms=decision_ms,
        )  # fmt: skip


def _size(*files: Path) -> float:
    """Return a folder's size, MB."""
    return sum(file.stat().st_size for file in files) / 1e6


def _cost(code: str, env: str, folder: Path, episodes: float) -> dict[str, float]:
    """Return what some Python takes in a process that loads nothing of this benchmark."""
    begin = "import json, sys, time; from pathlib import Path; env, folder, episodes = sys.argv[1:]"
    return _printed("-c", f"{begin}\n{code}{COST}", env, folder, int(episodes))


def _in_a_fresh_process(*command: object) -> dict[str, float]:
    return _printed(__file__, *command)


def _printed(*arguments: object) -> dict[str, float]:
    done = subprocess.run([sys.executable, *map(str, arguments)], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)
    figures: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return figures


def _resident() -> int:
    """Return the bytes of memory that this process has."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


if __name__ == "__main__":
    app()

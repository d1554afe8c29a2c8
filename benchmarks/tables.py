"""The published tables are made by the commands below them.

    python benchmarks/tables.py                  # all of them: hours, on a machine that does nothing else
    python benchmarks/tables.py ik optimality    # those of the commands that contain one of these words
    python benchmarks/tables.py --stale          # those that are older than a policy they show
    python benchmarks/tables.py --check          # only name these, and fail if there are any

A page names the command between two comments. What lies between them is replaced by what the command prints: the tables
of a benchmark, or the results and the verdict of a comparison, without the table of pairs; with `in short`, without how
episodes ended either, and with fewer columns. Of a sweep, it is one table of all levels, another one of the intervals,
and the robustness ranking:

    <!-- python benchmarks/ik.py -->
    <!-- end -->

    <!-- armctl compare reach_ik reach_ppo --seed test -->
    <!-- end -->

    <!-- in short: armctl compare --seed test -->
    <!-- end -->

    <!-- armctl sweep reach_ik reach_ppo --disturbance noise=0.02,0.05 --seed test -->
    <!-- end -->

Of a sweep with `--pairs`, it is all tables; of a suite, the headline and the map of kinds that lead; of worst cases,
the table and its caption.

The last comment before the end has a checksum of each policy that the block shows: of its networks, and of its episodes
there in `benchmarks/golden.json`, which is recorded anew whenever episodes change on purpose. A block of the sealed
test has the seed as well. Where one of them is another today, the block is stale. A record of what can no longer be
played is not made anew:

    <!-- record of 2026-11-25: reach_sac as it was -->
    <!-- end -->
"""

import argparse
import datetime
import functools
import hashlib
import itertools
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import pandas as pd

import armctl
from armctl.core.seeds import TEST_SEED
from armctl.policies import policy_names

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
COMMAND = r"(?P<form>in short: |as printed: )?(?P<command>(?:python benchmarks/|armctl )[^>]*?)"
BLOCK = re.compile(
    rf"^<!-- (?P<heading>{COMMAND}|record of [^>]*?) -->$(?P<body>.*?)^<!-- end -->$", re.MULTILINE | re.DOTALL
)
MARKS = re.compile(r"^<!-- shows (.*) -->$", re.MULTILINE)
WIDTH = "400"
"""Characters of the terminal that a benchmark gets, so that no cell is wrapped."""
TERMINAL = "80"
"""Characters of a terminal as it is printed."""
OUT = "results/test"
BRIEF_COLUMNS = 6
"""Columns of a comparison's table in short: those up to what a policy sees."""
TEST = "test seed"
WITHOUT_WORST_CASES = re.compile(r"\*\*Worst cases|\S+ fails in episode ")
"""Paragraphs of worst cases that pages leave out: the title, and commands that show failures."""


def renewed(page: str, chosen: Callable[[re.Match[str]], bool] = lambda block: True) -> str:
    """Return a page with new tables from the commands of the chosen blocks, or of all."""
    return BLOCK.sub(lambda block: _run(block) if block["command"] and chosen(block) else block[0], page)


def _run(block: re.Match[str]) -> str:
    command, form = block["command"], block["form"] or ""
    print(f"{command} ...", flush=True)
    with TemporaryDirectory() as folder:
        parts = _of_armctl(command, form, Path(folder)) if command.startswith("armctl ") else _of_benchmark(command)
    body = "\n\n".join([*parts, f"`{command}`, {datetime.date.today()}, armctl {armctl.__version__}"])
    marks = ", ".join(f"{name} {checksum}" for name, checksum in checksums(command, body).items())
    marker = f"\n\n<!-- shows {marks} -->" if marks else ""
    return f"<!-- {block['heading']} -->\n\n{body}{marker}\n\n<!-- end -->"


def _of_armctl(command: str, form: str, folder: Path) -> list[str]:
    words = ["-m", "armctl", *shlex.split(command)[1:], "--out", OUT]
    if form == "as printed: ":
        lines = map(str.rstrip, _printed(words, folder, TERMINAL).splitlines())
        return ["\n".join(("```text", *lines, "```"))]
    parts = results(_printed([*words, "--format", "markdown"], folder))
    if command.startswith("armctl suite "):
        return of_suite(parts)
    if command.startswith("armctl worst-case "):
        return [part for part in parts if not WITHOUT_WORST_CASES.match(part)]
    if command.startswith("armctl sweep ") and "--pairs" not in command:
        notes = [f"> {part.strip('*')}" for part in parts if part.startswith("**Under ")]
        return [*pivoted(pd.read_csv(folder / OUT / "sweep.csv")), *notes]
    return brief(parts) if form else parts


def _of_benchmark(command: str) -> list[str]:
    return tables(_printed(shlex.split(command)[1:], ROOT))


def _printed(words: Sequence[str], folder: Path, width: str = WIDTH) -> str:
    return subprocess.run(
        [sys.executable, *words], cwd=folder, env=os.environ | {"COLUMNS": width}, stdout=subprocess.PIPE, text=True,
        check=True,
    ).stdout  # fmt: skip


def results(printed: str) -> list[str]:
    """Return a comparison in Markdown, without titles and the table of pairs; how episodes ended is a list."""
    paragraphs = [part.strip() for part in printed.split("\n\n")]
    dropped = re.compile(r"\*\*[^\n]*episodes of seed|\*\*(Paired|Unpaired)|\| a - b|p: (McNemar|Barnard)")
    return [re.sub(r"^(\S+: \d)", r"- \1", part) for part in paragraphs if not dropped.match(part)]


def of_suite(parts: Sequence[str]) -> list[str]:
    """Return the headline of a suite, the map of the kinds that lead, and its legend."""
    start = next(i for i, part in enumerate(parts) if part.startswith("| task | none |"))
    return [*(f"> {part.strip('*')}" for part in parts if part.startswith("**Of ")), *parts[start : start + 2]]


def pivoted(points: pd.DataFrame) -> list[str]:
    """Return a sweep's success in %, and its 95 % intervals: a row for each policy, a column for each level."""
    neutral = ~points.duplicated(["disturbance", "policy"])
    cells: dict[str, dict[str, tuple[str, str]]] = {}
    for row, is_neutral in zip(points.to_dict("records"), neutral, strict=True):
        column = "undisturbed" if is_neutral else f"{row['disturbance']} {row['level']:g}"
        value, low, high = (f"{100 * row[name]:.0f}" for name in ("success", "low", "high"))
        texts = ("spared", "") if row["spared"] else (value, f"{low} to {high}")
        cells.setdefault(row["policy"], {}).setdefault(column, texts)
    columns = dict.fromkeys(column for by_column in cells.values() for column in by_column)
    heading = f"| | {' | '.join(columns)} |\n|{'---|' * (len(columns) + 1)}"
    parts = []
    for part in (0, 1):
        lines = (
            f"| `{policy}` | {' | '.join(by_column.get(column, ('-', ''))[part] for column in columns)} |"
            for policy, by_column in cells.items()
        )
        parts.append("\n".join((heading, *lines)))
    return [parts[0], "95 % intervals:", parts[1]]


def brief(parts: Sequence[str]) -> list[str]:
    """Return a comparison's verdict, and the first columns of its table."""
    (whole,) = (part for part in parts if part.startswith("| policy |"))
    rows = (line.split(" | ") for line in whole.splitlines())
    table = "\n".join(" | ".join(row[:BRIEF_COLUMNS]) + " |" for row in rows)
    return [*(f"> {part.strip('*')}" for part in parts if part.startswith("**")), table]


def tables(printed: str) -> list[str]:
    """Return the Markdown tables in what a benchmark prints, without the padding, and with a space before %."""
    lines = map(_narrow, printed.splitlines())
    groups = itertools.groupby(lines, lambda line: line.startswith("|"))
    return ["\n".join(group) for is_table, group in groups if is_table]


def _narrow(line: str) -> str:
    for pattern, plain in ((r"-+\|", "---|"), (r" +", " "), (r"(?<=\d)%", " %")):
        line = re.sub(pattern, plain, line.strip())
    return line


def stale(block: re.Match[str]) -> list[str]:
    """Return the policies in a block, or the test's seed, that are others now than when it was made."""
    if not block["command"]:
        return []
    stored = MARKS.search(block["body"])
    stored_checksums = dict(mark.rsplit(" ", 1) for mark in stored[1].split(", ")) if stored else {}
    present = checksums(block["command"], block["body"])
    return [name for name in {**stored_checksums, **present} if stored_checksums.get(name) != present.get(name)]


def checksums(command: str, body: str) -> dict[str, str]:
    """Return a checksum of each policy that a block's command or body names, and the test's seed if it is played."""
    words = set(re.findall(r"\w+", MARKS.sub("", f"{command} {body}").replace("\\", "")))
    tasks = _tasks_in(command, body)
    policies = {name: _checksum_of(name, tasks) for name in policy_names() if name in words}
    return policies | ({TEST: str(TEST_SEED)} if "seed test" in command else {})


def _tasks_in(command: str, body: str) -> frozenset[str]:
    """Return the ids of the environments that a block names; none if it names none."""
    default = {armctl.DEFAULT_ENV} if re.match(r"armctl (compare|sweep|worst-case) (?!.*--env)", command) else set()
    return frozenset(default | set(re.findall(r"armctl/\w+-v\d+", f"{command} {body}")))


@functools.cache
def _checksum_of(policy: str, tasks: frozenset[str]) -> str:
    """Return a checksum of a policy's networks, and of its episodes in some environments; without any, in all."""
    golden = json.loads((ROOT / "benchmarks" / "golden.json").read_text())
    episodes = {
        name: [run.get("outcomes"), run.get("lengths")]
        for name, run in golden.items()
        if name.endswith(f" {policy}") and (not tasks or name.split(" ")[0] in tasks)
    }
    agents = ROOT / "rl" / "agents"
    graphs = [agents / f"{policy}.onnx", *sorted((agents / "seeds").glob(f"{policy}-*.onnx"))]
    networks = [hashlib.sha256(graph.read_bytes()).hexdigest() for graph in graphs if graph.exists()]
    return hashlib.sha256(json.dumps([episodes, networks]).encode()).hexdigest()[:8]


def stale_blocks() -> Iterator[str]:
    for path in PAGES:
        for block in BLOCK.finditer(path.read_text()):
            if others := stale(block):
                yield f"{path.relative_to(ROOT)}: {block['command']}: {', '.join(others)}"


def main() -> None:
    """Make tables anew, or name those that are stale."""
    parser = argparse.ArgumentParser(description="Make the published tables anew by the commands that stand there.")
    parser.add_argument("words", nargs="*", help="only commands that contain one of these words")
    parser.add_argument("--stale", action="store_true", help="only tables older than a policy that they show")
    parser.add_argument("--check", action="store_true", help="make none; name the stale ones, and fail if there are")
    arguments = parser.parse_args()
    if arguments.check:
        blocks = list(stale_blocks())
        print("\n".join(blocks) or "No table is older than a policy that it shows.")
        sys.exit(bool(blocks))

    def chosen(block: re.Match[str]) -> bool:
        named = not arguments.words or any(word in block["command"] for word in arguments.words)
        return named and (not arguments.stale or bool(stale(block)))

    for path in PAGES:
        page = path.read_text()
        if (new := renewed(page, chosen)) != page:
            path.write_text(new)


if __name__ == "__main__":
    main()

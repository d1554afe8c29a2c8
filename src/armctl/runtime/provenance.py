"""Provenance of results: versions of packages, the machine, and the run that played an episode."""

import contextlib
import functools
import os
import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from armctl import DISTRIBUTION
from armctl.core.files import digest

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""Environment variables that say how many threads a process may use."""
MAX_BACKGROUND_LOAD = 0.25
"""Share of the cores that other processes may keep busy while decisions are held against deadlines."""


@dataclass(frozen=True)
class Run:
    """Call of `compare`: when, with what and where its episodes were played. Loads are one-minute averages."""

    id: str
    """Digest of the comparison's identity and of all that is known at the start, after a word: digits alone, or with
    an `e` among them, are a number for whoever reads a CSV file."""
    date: str
    """UTC."""
    versions: dict[str, str]
    processor: str
    cores: int | None
    threads: dict[str, str]
    """Values of those of `THREADS` that are set."""
    worlds: int
    workers: int
    load_start: float | None = None
    """None where the system does not tell."""
    load_most: float | None = None
    """Highest load at the end of any episode; this and the next are None if the run was killed."""
    load_end: float | None = None
    load_own: float | None = None
    """Processor time of this process, over the time that passed."""
    judged: int | None = None
    """Number of episodes of every policy after which it told a verdict; None if it was killed before."""
    baseline: str | None = None
    """Baseline of the verdict; the next is its margin."""
    margin: float | None = None
    """None if it was killed before."""
    overwritten: bool = False
    """True if its episodes were overwritten: what it told was seen, and counts as a look."""

    @property
    def busy(self) -> bool:
        """True if other processes kept more than `MAX_BACKGROUND_LOAD` of the cores busy; an unknown load is 0."""
        loads = [load for load in (self.load_start, self.load_most, self.load_end) if load is not None]
        return max(loads, default=0.0) - max(1.0, self.load_own or 0.0) > MAX_BACKGROUND_LOAD * (self.cores or 1)


class RunMeter:
    """Notes the load while a run goes on."""

    def __init__(self, identity: Mapping[str, Any], num_envs: int, workers: int) -> None:
        facts: dict[str, Any] = {
            "date": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "versions": versions(),
            **machine(),
            "threads": {name: os.environ[name] for name in THREADS if name in os.environ},
            "worlds": num_envs,
            "workers": workers,
            "load_start": load_average(),
        }
        self.run = Run(f"run-{digest([identity, facts])}", **facts)
        self._highest_load = self.run.load_start
        self._wall, self._processor = time.perf_counter(), time.process_time()

    def update_load(self) -> None:
        """Note the load of this moment."""
        if self._highest_load is not None:
            self._highest_load = max(self._highest_load, load_average() or 0.0)

    def finished(self, judged: int, baseline: str | None, margin: float) -> Run:
        """Return the run with its loads, after so many judged episodes of every policy."""
        self.update_load()
        own_load = (time.process_time() - self._processor) / max(time.perf_counter() - self._wall, 1e-9)
        return replace(
            self.run, load_most=self._highest_load, load_end=load_average(), load_own=round(own_load, 2), judged=judged,
            baseline=baseline, margin=margin,
        )  # fmt: skip


def earlier_looks(runs: Sequence[Run]) -> list[int]:
    """Return the numbers of episodes of every policy after which runs before the last one told a verdict.

    The same episodes are seen once, but those that were overwritten are others.
    """
    looks = {run.judged for run in runs[:-1] if run.judged} - {run.judged for run in runs[-1:]}
    return sorted(looks | {*overwritten_looks(runs)})


def overwritten_looks(runs: Sequence[Run]) -> list[int]:
    """Return the numbers of other episodes of every policy, overwritten since, after which a verdict was told."""
    return sorted({run.judged for run in runs if run.overwritten and run.judged})


def looks_in_words(looks: Sequence[int]) -> str:
    """Return what earlier looks mean for a verdict, as a part of its sentence; there is at least one."""
    counts = [f"{count:,}" for count in looks]
    listed = counts[0] if len(counts) == 1 else f"{', '.join(counts[:-1])} and {counts[-1]}"
    times = f"{len(counts)} earlier looks" if len(counts) > 1 else "an earlier look"
    return f"after {times} at {listed} episodes, p is too small and intervals are too narrow"


def with_looks(sentence: str, looks: Sequence[int]) -> str:
    """Return a sentence that names earlier looks at its end; an empty one stays empty."""
    return f"{sentence.removesuffix('.')}; {looks_in_words(looks)}." if sentence and looks else sentence


def argument_notes(runs: Sequence[Run], baseline: str | None, margin: float) -> list[str]:
    """Return a remark if a verdict was told before by other arguments than these."""
    others = {(run.baseline, run.margin) for run in runs if run.judged and run.margin is not None}
    others -= {(baseline, margin)}
    arguments = sorted(f"{f'baseline {name}' if name else 'no baseline'}, margin {other:g}" for name, other in others)
    return [f"A verdict was told before by other arguments: {'; '.join(arguments)}."] if arguments else []


def load_average() -> float | None:
    """Return the mean number of processes that ran or waited in the last minute; None where the system is silent."""
    try:
        return round(os.getloadavg()[0], 2)
    except (AttributeError, OSError):
        return None


def processor_model() -> str:
    """Return the processor's name, as far as the system tells it."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() in ("model name", "Model") and value.strip():
                return value.strip()
    return platform.processor() or platform.machine()


@functools.cache
def _versions() -> dict[str, str]:
    packages = (
        DISTRIBUTION,
        "mujoco",
        "pin",
        "casadi",
        "eaik",
        "ompl",
        "osqp",
        "ruckig",
        "gymnasium",
        "numpy",
        "scipy",
        "onnxruntime",
        "example-robot-data",
        "numba",
        "llvmlite",
        "coal",
    )
    numbers = {"python": platform.python_version()} | {package: version(package) for package in packages}
    with contextlib.suppress(PackageNotFoundError):  # only learners need it
        numbers["torch"] = version("torch")
    return numbers


def versions() -> dict[str, str]:
    """Return versions of Python and of the packages on which results depend."""
    return dict(_versions())


def machine() -> dict[str, Any]:
    """Return properties of the machine on which decision times depend."""
    return {"processor": processor_model(), "cores": os.cpu_count()}

"""Speed of one core: arithmetic, memory, wake-ups, calls, and operations in compiled code.

A `Measure` runs for about that many seconds, and gives the time of one, s.
"""

import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from limit_model import Machine
from printing import versioned_table
from rich.table import Table

from armctl.kernels.compiling import compiled

Measure = Callable[[float], float]

MATRIX = 1024
"""Rows of a matrix whose product has the peak speed."""
FLOAT64, FLOAT32 = "float64", "float32"
COPIES = {"copy within L2": 2**19, "copy within L3": 2**22, "copy in memory": 2**28}
"""Bytes read and written by copies."""
BLOCK = 2**21
"""Bytes read and written that are timed together."""
PROCESS, THREAD = "wake-up of a process", "wake-up of a thread"
CALL, ANGLE = "call of an empty compiled function", "sine, cosine or arc tangent"


def timed(step: Callable[[int], object], block: int = 1, clock: Callable[[], float] = time.thread_time) -> Measure:
    """Time `step` with 0, 1 ..., `block` calls together: the median over blocks, by default of processor time."""

    def run(seconds: float) -> float:
        times, end = list[float](), time.perf_counter() + seconds
        while time.perf_counter() < end or not times:
            begin = clock()
            for i in range(block):
                step(i)
            times.append((clock() - begin) / block)
        return float(np.median(times))

    return run


def shared(measure: Measure, count: float) -> Measure:
    """Measure one of `count` that are done together."""
    return lambda seconds: measure(seconds) / count


def speeds() -> dict[str, Measure]:
    """Return what is measured of any core: seconds of a flop, of a byte read or written, and of the rest."""
    return {
        FLOAT64: _product(np.float64), FLOAT32: _product(np.float32),
        **{name: _copy(size // 2) for name, size in COPIES.items()},
        PROCESS: _wake_up(_in_process), THREAD: _wake_up(_in_thread), CALL: timed(_empty, 1000), ANGLE: _angles(),
    }  # fmt: skip


def machine_of(seconds: dict[str, float]) -> Machine:
    """Return the machine with these times."""
    peaks = {precision: 1 / seconds[precision] for precision in (FLOAT64, FLOAT32)}
    bandwidths = {size: 1 / seconds[name] for name, size in COPIES.items()}
    return Machine(peaks, bandwidths, seconds[PROCESS], seconds)


def speed_table(seconds: dict[str, float]) -> Table:
    """Return a table of the times, or of their inverses."""
    table = versioned_table("one core", "", "unit")
    for name, value in seconds.items():
        if name in (FLOAT64, FLOAT32):
            table.add_row(f"matrix product, {name}", f"{1e-9 / value:.1f}", "Gflop/s")
        elif name in COPIES:
            table.add_row(name, f"{1e-9 / value:.1f}", "GB/s, read and written")
        else:
            table.add_row(name, f"{1e6 * value:.3g}", "us")
    return table


def pin_to_one_core() -> None:
    """Begin this script again on one core, unless it is: libraries count cores when they are imported."""
    cores = os.sched_getaffinity(0)
    if len(cores) > 1:
        os.sched_setaffinity(0, {max(cores)})
        os.execv(sys.executable, sys.orig_argv)


def _product(precision: Any) -> Measure:
    a = np.random.default_rng(0).random((MATRIX, MATRIX)).astype(precision)
    out = a.copy()
    return shared(timed(lambda _: np.matmul(a, a, out=out)), 2 * MATRIX**3)


def _copy(size: int) -> Measure:
    source, target = np.ones(size, np.uint8), np.zeros(size, np.uint8)
    return shared(timed(lambda _: np.copyto(target, source), max(1, BLOCK // (2 * size))), 2 * size)


def _wake_up(start: Callable[[Callable[[], None]], None]) -> Measure:
    """Measure half of a byte's way to what `start` runs beside this, and back, through pipes."""
    (their_read, write), (read, their_write) = os.pipe(), os.pipe()

    def echo() -> None:
        while os.read(their_read, 1):
            os.write(their_write, b".")

    def round_trip(_: int) -> None:
        os.write(write, b".")
        os.read(read, 1)

    start(echo)
    return shared(timed(round_trip, 10, time.perf_counter), 2)


def _in_process(work: Callable[[], None]) -> None:
    multiprocessing.get_context("fork").Process(target=work, daemon=True).start()


def _in_thread(work: Callable[[], None]) -> None:
    threading.Thread(target=work, daemon=True).start()


@compiled
def _empty(number):
    """Do nothing with a number."""


def _angles() -> Measure:
    y, x = np.random.default_rng(0).uniform(-3, 3, (2, 4096))
    out = np.empty_like(x)

    def step(_: int) -> None:
        np.sin(x, out=out)
        np.cos(x, out=out)
        np.arctan2(y, x, out=out)

    return shared(timed(step), 3 * len(x))

"""Makes the pool of layouts that comes with armctl: `python -m armctl.tasks.reach.make_layout_pool`.

With the same versions of all packages, it makes the same file again.
"""

import functools
import multiprocessing
import os
import zlib
from pathlib import Path

import numpy as np
import typer
from rich.progress import Progress

from armctl.console import PlainConsole
from armctl.disturbances import episode_entropy
from armctl.files import write_atomically
from armctl.kinematics import ArmModel, Workspace
from armctl.planning import PathCertificate
from armctl.robot_description import load_arm
from armctl.seeds import TEST_SEED
from armctl.tasks.reach.layout_pool import PARTS, POOL_FILE, LayoutPool, robot_digest, write_pool
from armctl.tasks.reach.obstacle_layout import ReachLayout, sample_certified_layout
from armctl.tasks.reach.options import ReachOptions

SIZES = {"test": 1000, "development": 2000, "validation": 1000, "training": 7000}
"""Layouts that are drawn for each part."""


def layout_of(part: str, number: int) -> tuple[ReachLayout, bool]:
    """A layout of the pool, and whether it is certified. That of `test` is the episode's, as drawn without a pool."""
    test = part == "test"
    sequence = (
        np.random.SeedSequence(episode_entropy(TEST_SEED, number))
        if test
        else np.random.SeedSequence(number, spawn_key=(zlib.crc32(part.encode()),))
    )
    workspace, certificate = _tools()
    rng, tolerance = np.random.default_rng(sequence), ReachOptions().tolerance
    return sample_certified_layout(rng, workspace, certificate, tolerance, solvable=test)


@functools.cache
def _tools() -> tuple[Workspace, PathCertificate]:
    model = ArmModel(load_arm(ReachOptions().robot))
    return Workspace(model), PathCertificate(model)


def _drawn(name: tuple[str, int]) -> tuple[ReachLayout, bool]:
    return layout_of(*name)


def main(processes: int = os.cpu_count() or 1, out: Path = POOL_FILE) -> None:
    """Draw and certify all layouts in parallel, and write the pool."""
    names = [(part, number) for part in PARTS for number in range(SIZES[part])]
    with multiprocessing.get_context("spawn").Pool(processes) as workers:
        drawn = workers.imap(_drawn, names, chunksize=20)
        found: list[tuple[ReachLayout, bool]] = []
        with Progress(console=PlainConsole(stderr=True)) as progress:
            bar = progress.add_task("layouts", total=len(names))
            for one in drawn:
                found.append(one)
                progress.advance(bar)
    layouts, feasible = zip(*found, strict=True)
    defaults = ReachOptions()
    boxes = [one.boxes.numbers for one in layouts]
    pool = LayoutPool(
        robot=robot_digest(load_arm(defaults.robot)),
        tolerance=defaults.tolerance,
        sizes=np.array([SIZES[part] for part in PARTS]),
        targets=np.array([one.target for one in layouts], dtype=np.float32),
        counts=np.array([len(one.boxes) for one in layouts], dtype=np.uint8),
        packed=np.concatenate(boxes, dtype=np.float32),
        feasible=np.array(feasible),
    )
    write_atomically(out, functools.partial(write_pool, pool))
    certified = ", ".join(f"{part} {pool.feasible[rows].sum()} of {len(rows)}" for part, rows in pool.parts.items())
    print(f"{out}: {out.stat().st_size:,} bytes; certified: {certified}")


if __name__ == "__main__":
    typer.run(main)

"""Makes the pool of layouts that comes with armctl: `python tools/make_layout_pool.py`.

With the same versions of all packages, it makes the same file again. After a release has drawn another test's seed,
`--keep` draws the layouts of its episodes only.
"""

import dataclasses
import functools
import multiprocessing
import os
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.progress import Progress

from armctl.core.console import PlainConsole
from armctl.core.files import write_atomically
from armctl.disturbances import episode_entropy
from armctl.kinematics import ArmModel, Workspace
from armctl.planning import PathCertificate
from armctl.robot_description import load_arm
from armctl.tasks.reach.layout_pool import (
    PARTS,
    POOL_FILE,
    SEEDS_WITH_LAYOUTS,
    LayoutPool,
    read_pool,
    robot_digest,
    write_pool,
)
from armctl.tasks.reach.obstacle_layout import MAX_OBSTACLES, ReachLayout, sample_certified_layout
from armctl.tasks.reach.options import ReachOptions

SIZES = {"development": 2000, "validation": 1000, "training": 7000}
"""Numbers of layouts of the parts that many seeds draw from."""
LAYOUTS_PER_SEED = 1000
"""Number of layouts of a seed of its own: those of its first episodes."""


def layout_of(part: str | int, number: int) -> tuple[ReachLayout, bool]:
    """Return a layout of the pool, and whether it is certified. That of a seed is the episode's without a pool."""
    is_seed = isinstance(part, int)
    sequence = (
        np.random.SeedSequence(episode_entropy(part, number))
        if isinstance(part, int)
        else np.random.SeedSequence(number, spawn_key=(zlib.crc32(part.encode()),))
    )
    workspace, certificate = _tools()
    rng, tolerance = np.random.default_rng(sequence), ReachOptions().tolerance
    return sample_certified_layout(rng, workspace, certificate, tolerance, solvable=is_seed)


@functools.cache
def _tools() -> tuple[Workspace, PathCertificate]:
    model = ArmModel(load_arm(ReachOptions().robot))
    return Workspace(model), PathCertificate(model)


def _layout_of(name: tuple[str | int, int]) -> tuple[ReachLayout, bool]:
    return layout_of(*name)


def draw(sizes: Mapping[str | int, int], processes: int) -> LayoutPool:
    """Draw and certify layouts in parallel: so many of each part, of seeds first. A pool has all of `PARTS`."""
    names = [(part, number) for part, size in sizes.items() for number in range(size)]
    with multiprocessing.get_context("spawn").Pool(processes) as workers:
        pairs = workers.imap(_layout_of, names, chunksize=20)
        with Progress(console=PlainConsole(stderr=True)) as progress:
            bar, results = progress.add_task("layouts", total=len(names)), []
            for pair in pairs:
                results.append(pair)
                progress.advance(bar)
    layouts, feasible = zip(*results, strict=True)
    return LayoutPool(
        robot=robot_digest(load_arm(ReachOptions().robot)),
        tolerance=ReachOptions().tolerance,
        seeds=np.array([part for part in sizes if isinstance(part, int)], dtype=np.int64),
        sizes=np.array(list(sizes.values())),
        targets=np.array([layout.target for layout in layouts], dtype=np.float32),
        counts=np.array([len(layout.boxes) for layout in layouts], dtype=np.uint8),
        packed=np.concatenate([layout.boxes.numbers for layout in layouts], dtype=np.float32),
        feasible=np.array(feasible),
    )


def with_seeds(pool: LayoutPool, seeds: Sequence[int], processes: int, size: int = LAYOUTS_PER_SEED) -> LayoutPool:
    """Return a pool with the layouts of other seeds' episodes; those that it has already are kept, and all parts."""
    new = [seed for seed in seeds if str(seed) not in pool.names]
    additions = draw(dict.fromkeys(new, size) | dict.fromkeys(PARTS, 1), processes) if new else pool
    picked = [(additions if seed in new else pool, str(seed)) for seed in seeds] + [(pool, part) for part in PARTS]
    rows = [of.parts[name] for of, name in picked]

    def joined(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(source, name)[part] for (source, _), part in zip(picked, rows, strict=True)])

    counts = joined("counts")
    return dataclasses.replace(
        pool,
        seeds=np.array(seeds, dtype=np.int64),
        sizes=np.array([len(part) for part in rows]),
        targets=joined("targets"),
        counts=counts,
        packed=joined("boxes")[np.arange(MAX_OBSTACLES) < counts[:, None]],
        feasible=joined("feasible"),
    )


def main(
    processes: Annotated[int, typer.Option(min=1)] = os.cpu_count() or 1,
    out: Path = POOL_FILE,
    keep: Annotated[bool, typer.Option("--keep", help="Draw only for seeds of which the file has no layouts.")] = False,
) -> None:
    """Draw and certify layouts, and write the pool."""
    seeds = list(dict.fromkeys(SEEDS_WITH_LAYOUTS))
    pool = (
        with_seeds(read_pool(out), seeds, processes)
        if keep
        else draw(dict.fromkeys(seeds, LAYOUTS_PER_SEED) | SIZES, processes)
    )
    write_atomically(out, functools.partial(write_pool, pool))
    certified = ", ".join(f"{part} {pool.feasible[rows].sum()} of {len(rows)}" for part, rows in pool.parts.items())
    print(f"{out}: {out.stat().st_size:,} bytes; certified: {certified}")


if __name__ == "__main__":
    typer.run(main)

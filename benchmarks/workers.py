"""Speed-up of a comparison by more processes, and a check that they find the same.

    python benchmarks/workers.py [--env armctl/ArmReach-v0] [--episodes 400] [--workers 2]

All of the environment's default policies play. Workers are started before the clock, as they are once a session; then
one process and several take turns, and figures are medians over the rounds. Run it on a machine that does nothing else.
"""

import os
import time

import numpy as np
import pandas as pd
import typer
from printing import markdown_table, progress, show

import armctl
from armctl.episodes.record import TIME_COLUMNS


def timed(env: str, episodes: int, workers: int) -> tuple[float, pd.DataFrame]:
    """Return the seconds that a comparison takes, and its episodes without what depends on the machine."""
    start = time.perf_counter()
    comparison = armctl.compare(env=env, episodes=episodes, workers=workers, policy_seed=0)
    if comparison.failures or comparison.interrupted:
        raise SystemExit(f"the comparison did not come to its end: {comparison.failures}")
    return time.perf_counter() - start, comparison.episodes.drop(columns=list(TIME_COLUMNS))


def main(env: str = armctl.DEFAULT_ENV, episodes: int = 400, workers: int = 2, rounds: int = 3) -> None:
    """Measure, and print a table."""
    counts = (1, workers)
    timed(env, 4 * workers, workers)
    seconds: dict[int, list[float]] = {count: [] for count in counts}
    for _ in progress(range(rounds)):
        episodes_of = {}
        for count in counts:
            took, episodes_of[count] = timed(env, episodes, count)
            seconds[count].append(took)
        if not episodes_of[1].equals(episodes_of[workers]):
            raise SystemExit(f"{workers} workers found other episodes than one")
    title = f"{env}, {episodes} episodes, {len(os.sched_getaffinity(0))} cores, armctl {armctl.__version__}"
    table = markdown_table("workers", "seconds", "gain", "of linear", title=title)
    for count in counts:
        gain = float(np.median(np.array(seconds[1]) / np.array(seconds[count])))
        table.add_row(str(count), f"{np.median(seconds[count]):.1f}", f"{gain:.2f}", f"{gain / count:.0%}")
    show(table)


if __name__ == "__main__":
    typer.run(main)

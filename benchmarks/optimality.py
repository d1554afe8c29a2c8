"""Check of the time-optimal reference: the least time that joint limits allow, against what policies need.

    python benchmarks/optimality.py [--episodes 10000] [--policies reach_ik,reach_ppo,reach_mpc]

No policy should be sooner by more than the one decision that servos and sampling may be off.
"""

import numpy as np
import pandas as pd
import typer
from printing import markdown_table, show
from rich.progress import Progress

from armctl.study import compare


def main(episodes: int = 10_000, seed: int = 0, policies: str = "reach_ik,reach_ppo,reach_mpc") -> None:
    """Play the same episodes with each policy, and print a table."""
    names = policies.split(",")
    with Progress(transient=True) as bar:
        task = bar.add_task("episodes", total=episodes * len(names))
        comparison = compare(names, episodes=episodes, seed=seed, worlds=100, progress=lambda result: bar.advance(task))
    table = markdown_table(
        "policy", "reached", "over the least time: median", "95 % interval", "90th percentile",
        "earlier by 1 control step", "by more",
    )  # fmt: skip
    table.title = f"armctl/ArmReach-v0, {episodes:,} episodes, decisions over the least possible"
    summaries = {summary.policy: summary for summary in comparison.policies}
    for name, group in comparison.episodes.groupby("policy", sort=False):
        table.add_row(f"`{name}`", *row(group, summaries[name]))
    show(table)


def row(episodes: pd.DataFrame, summary) -> list[str]:
    """Return the cells of one policy."""
    ahead = (episodes.lower_bound_steps - episodes.length)[episodes.success]
    gap = summary.optimality_gap
    return [
        f"{episodes.success.mean():.2%}",
        f"{gap.value:.1%}",
        f"{gap.low:.1%} to {gap.high:.1%}",
        f"{np.nanquantile(episodes.optimality_gap, 0.9):.1%}",
        f"{(ahead == 1).sum()}",
        f"{(ahead > 1).sum()}",
    ]


if __name__ == "__main__":
    typer.run(main)

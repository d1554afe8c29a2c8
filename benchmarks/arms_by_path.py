"""Reaching among boxes with arms given by the path of a URDF file, without armctl's choices for named arms.

    python benchmarks/arms_by_path.py [--episodes 24] [--seed 0] [--policy reach_mpc]

The files are those of example-robot-data. A file says nothing of pairs of links that cannot touch, nor of a home: the
arm starts with its joints at zero, or in the middle of their range, or above the floor if that is in it.
"""

from pathlib import Path
from typing import Annotated

import typer

from armctl.robot_description import BUILTIN_ARMS
from armctl.robot_description.arm import robot_data
from armctl.rollout import evaluate

OBSTACLES = "armctl/ArmReachObstacles-v0"


def main(
    episodes: int = 24,
    seed: int = 0,
    policy: str = "reach_mpc",
    arm: Annotated[list[str] | None, typer.Option()] = None,
) -> None:
    """Play, and print how episodes end on each arm's file."""
    print(f"| file of `{policy}` | reached | collided | timeout | mean steps |\n|---|---|---|---|---|")
    for name in arm or BUILTIN_ARMS:
        file, tip = robot_data() / BUILTIN_ARMS[name].urdf, BUILTIN_ARMS[name].tip
        options = {"robot": str(file), "tip": tip}
        results = evaluate(
            policy,
            OBSTACLES,
            episodes=episodes,
            seed=seed,
            worlds=episodes,
            env_options=options,
            lower_bound_steps=False,
        )
        counts = [int((results.outcome == outcome).sum()) for outcome in ("reached", "collided", "timeout")]
        print(f"| `{Path(file).name}` | {' | '.join(map(str, counts))} | {results.length.mean():.0f} |", flush=True)


if __name__ == "__main__":
    typer.run(main)

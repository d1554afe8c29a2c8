"""Control steps per second of the bridge without physics, beside those of the same bridge with it, and the ratio.

    python benchmarks/planar.py [--env armctl/BridgeCrossMoving-v0] [--worlds 256] [--seconds 3]

With random commands, for each observation that both can show alike: the true state, and the depth camera or what
replaces it, ranges. The two take turns, and the ratio is the median over the rounds.
"""

import time

import numpy as np
import typer
from printing import markdown_table, show

from armctl.envs import EpisodeVectorEnv, make_worlds

ROUNDS = 5
OBSERVATIONS = {"state": ("state", "state"), "camera": ("camera", "ranges")}
"""Observations of worlds with and without physics."""


def main(env: str = "armctl/BridgeCrossMoving-v0", worlds: int = 256, seconds: float = 3.0) -> None:
    """Print a row for each observation."""
    table = markdown_table("observation", "with physics", "without", "ratio")
    for name, (true, kinematic) in OBSERVATIONS.items():
        pair = [
            make_worlds(env, worlds, {"observation": true}),
            make_worlds(env, worlds, {"observation": kinematic, "dynamics": "kinematic"}),
        ]
        for each in pair:
            steps_per_second(each, 0.1)  # compiles
        rates = np.array([[steps_per_second(each, seconds) for each in pair] for _ in range(ROUNDS)])
        physics, planar = np.median(rates, axis=0)
        table.add_row(name, f"{physics:,.0f}", f"{planar:,.0f}", f"{np.median(rates[:, 1] / rates[:, 0]):.1f}")
    show(table, width=100)


def steps_per_second(env: EpisodeVectorEnv, seconds: float) -> float:
    """Control steps per second, over all worlds, resets included."""
    env.reset(seed=0)
    rng, low, high = np.random.default_rng(0), [-0.3, -2.0], [1.6, 2.0]
    steps, begin = 0, time.perf_counter()
    while time.perf_counter() - begin < seconds:
        env.step(rng.uniform(low, high, (env.num_envs, 2)))
        steps += env.num_envs
    return steps / (time.perf_counter() - begin)


if __name__ == "__main__":
    typer.run(main)

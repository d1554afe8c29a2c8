"""The score of the BARN challenge (Xiao et al. 2022): success * T / clip(time, 2 T, 8 T), where T is the least time.

    python benchmarks/barn.py [FOLDER] [--moving] [--policies bridge_ompl,bridge_mpc] [--episodes 300] [--seed 305]

FOLDER has the challenge's static worlds, `worlds/BARN` of github.com/Daffan/the-barn-challenge; without it, fields are
new ones. With `--moving`, they are the challenge's moving fields. T is that of the shortest path around what stands
still, with a clearance of 0.36 m, at 2 m/s. The challenge drives a Jackal with a lidar in Gazebo, to within 1 m of a
point, in at most 100 s: its published figures are not from this simulator.
"""

from contextlib import closing
from typing import Annotated

import numpy as np
import typer
from printing import markdown_table, progress, show

import armctl
from armctl.baselines.bridge_controllers import NARROW_CLEARANCE
from armctl.envs import make_worlds
from armctl.planning import PathPlannerOptions, plan_path
from armctl.robots.rover import MAX_VELOCITY
from armctl.tasks.bridge import CONTROL_PERIOD
from armctl.tasks.bridge.world import START_X

STATIC, MOVING = "armctl/BarnCross-v0", "armctl/BarnCrossMoving-v0"
POLICIES = "bridge_ompl,bridge_mpc,bridge_dwa,bridge_distil"
WORLDS = 10


def main(
    folder: Annotated[str | None, typer.Argument(help="Folder of the challenge's static worlds.")] = None,
    *,
    moving: bool = False,
    policies: str = POLICIES,
    episodes: int = 300,
    seed: int = 305,
) -> None:
    """Play the same fields with each policy, and print a table."""
    names = policies.split(",")
    env, fields = (MOVING, "challenge") if moving else (STATIC, folder)
    options = {"fields": fields} if fields else {}
    times = shortest_times(env, options, episodes, seed)
    comparison = armctl.compare(names, env, episodes=episodes, seed=seed, worlds=WORLDS, env_options=options)
    summaries = {summary.policy: summary for summary in comparison.policies}
    table = markdown_table("policy", "sees", "success", "collided", "time, s: median", "score")
    table.title = f"{env}, {episodes} episodes of seed {seed}, the challenge's worlds: {'yes' if fields else 'no'}"
    for name, group in comparison.episodes.groupby("policy", sort=False):
        time = CONTROL_PERIOD * group.length.to_numpy()
        fastest = times[group.episode.to_numpy()]
        score = group.success.to_numpy() * fastest / np.clip(time, 2 * fastest, 8 * fastest)
        success = summaries[name].success
        table.add_row(
            f"`{name}`", summaries[name].sees, f"{success.value:.1%} [{success.low:.1%} to {success.high:.1%}]",
            f"{(group.outcome == 'collided').mean():.1%}", f"{np.median(time[group.success]):.1f}",
            f"{score.mean():.3f}",
        )  # fmt: skip
    show(table, width=160)


def shortest_times(name: str, options: dict[str, str], episodes: int, seed: int) -> np.ndarray:
    """Return the time (episodes,) s of the shortest path at full speed."""
    choice, times = PathPlannerOptions(clearance=NARROW_CLEARANCE), []
    with closing(make_worlds(name, 1, {**options, "observation": "state"})) as env:
        for episode in progress(range(episodes), "shortest paths"):
            env.reset(seed=seed, options={"episode": episode})
            plan = plan_path(env.task.static_map(0), (START_X, 0.0), env.task.goal_x, choice)
            times.append(plan.length / MAX_VELOCITY[0])
    return np.array(times)


if __name__ == "__main__":
    typer.run(main)

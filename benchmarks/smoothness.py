"""The price of smoothness: jerk of the true motion, and time to the target, of the arm's policies.

    python benchmarks/smoothness.py [--episodes 200] [--seed 4043]

The second table compares times of `reach_ruckig`, to 8 ms, with the jerk-limited optimum of each episode: the earliest
entry into the target sphere, by Ruckig's own motion from rest, over many configurations and free of collisions.
"""

import numpy as np
import typer
from printing import markdown_table, progress, show

import armctl
from armctl.control.trajectory import JerkLimitedMotion
from armctl.envs import make_worlds
from armctl.kinematics import THOROUGH, ArmModel, MinimumTimeReach
from armctl.robot_description.joint_profiles import TICK, fly_by_setpoint
from armctl.rollout import evaluate
from armctl.tasks.reach import CONTROL_PERIOD

REACH, MOVING, OBSTACLES = "armctl/ArmReach-v0", "armctl/ArmReachMoving-v0", "armctl/ArmReachObstacles-v0"
LINE_UP = (
    (REACH, "reach_ik", "position"), (REACH, "reach_mpc", "position"), (REACH, "reach_ruckig", "velocity"),
    (REACH, "reach_ruckig", "position"), (REACH, "reach_ruckig:acceleration=0.5", "velocity"),
    (REACH, "reach_rate", "velocity"), (REACH, "reach_impedance", "torque"), (REACH, "reach_ppo", "relative"),
    (MOVING, "reach_ik", "position"), (MOVING, "reach_ruckig", "velocity"), (OBSTACLES, "reach_ompl", "position"),
    (OBSTACLES, "reach_ompl:jerk_limited=true", "velocity"), (OBSTACLES, "reach_ompl:jerk_limited=true", "position"),
)  # fmt: skip
"""Environments, policies and controls."""
JERKS = ("joint_jerk_max", "joint_jerk_rms", "tip_jerk_max", "tip_jerk_rms")
STEP = 0.002
"""s: time between the points of a motion at which its entry is looked for."""
EARLIER = (0.0, 0.02, 0.05)
"""s by which fly-by setpoints are for an earlier arrival: joints then overrun the configuration by more."""


def main(episodes: int = 200, seed: int = 4043) -> None:
    """Play the same episodes with each policy, and print a table."""
    table = markdown_table(
        "task", "policy", "control", "success", "time, s", "joints' jerk: largest, rad/s^3", "rms",
        "tip's jerk: largest, m/s^3", "rms", "log dimensionless jerk",
    )  # fmt: skip
    for env, policy, control in progress(LINE_UP):
        results = evaluate(
            policy, env, episodes=episodes, seed=seed, worlds=20, env_options={"control": control},
            lower_bound_steps=False,
        )  # fmt: skip
        won = results[results.success]
        numbers = (f"{won[name].mean():,.0f}" for name in JERKS)
        time, smoothness = f"{CONTROL_PERIOD * won.length.mean():.3f}", f"{won.smoothness.mean():.2f}"
        name = env.removeprefix("armctl/").removesuffix("-v0")
        table.add_row(name, f"`{policy}`", control, f"{results.success.mean():.1%}", time, *numbers, smoothness)
    times, optima, jerk = jerk_limited_reaches(episodes, seed)
    reached = np.isfinite(times)
    optimum = markdown_table(
        "`reach_ruckig`", "time, s", "jerk-limited optimum, s", "over it", "largest commanded jerk, rad/s^3"
    )
    mean, best = times[reached].mean(), optima[reached].mean()
    reaches = f"{reached.sum()} of {episodes} reached"
    optimum.add_row(reaches, f"{mean:.4f}", f"{best:.4f}", f"{mean / best - 1:.2%}", f"{jerk:.1f}")
    show(table, optimum, width=200)


def jerk_limited_reaches(episodes: int, seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Return times and optima (episodes,) s, and the largest mean jerk in a period that was commanded, rad/s^3."""
    envs = make_worlds(REACH, episodes, {"control": "velocity"})
    policy = armctl.make_policy("reach_ruckig", envs)
    observations, _ = envs.reset(seed=[seed] * episodes, options={"episode": np.arange(episodes)})
    policy.reset(np.arange(episodes, dtype=np.int32))
    tolerance, dof = envs.task.options.tolerance, envs.task.arm.description.dof
    targets = observations[:, 6 + dof - 3 : 6 + dof].astype(float)
    search, home = MinimumTimeReach(ArmModel("ur5"), THOROUGH), envs.task.arm.description.home
    optima = np.array([earliest_entry(search, home, target, tolerance) for target in progress(targets)])
    times, accelerations, largest = np.full(episodes, np.inf), np.zeros((episodes, dof)), 0.0
    for step in range(100):
        observations, *_ = envs.step(policy.act(observations))
        inside = np.linalg.norm(envs.task.motion().path - targets, axis=-1) <= tolerance
        arrivals = CONTROL_PERIOD * step + TICK * (1 + inside.argmax(axis=0))
        playing = np.isinf(times)
        new = np.array([controller._motion.acceleration for controller in policy.controllers])
        largest = max(largest, float(np.abs(new - accelerations)[playing].max(initial=0.0)) / CONTROL_PERIOD)
        times, accelerations = np.where(playing & inside.any(axis=0), arrivals, times), new
    return times, optima, largest


def earliest_entry(search: MinimumTimeReach, home: np.ndarray, target: np.ndarray, tolerance: float) -> float:
    """Return the earliest time (s) at which a free jerk-limited motion from rest at home is in the target sphere."""
    model, motion, best = search.model, JerkLimitedMotion(search.model.limits, CONTROL_PERIOD, home), np.inf
    configurations = np.vstack((search.candidates(home, target, tolerance), search.at_centre(home, target)))
    for q, time in zip(configurations, model.min_time(home, configurations), strict=True):
        for earlier in EARLIER if time < best else ():
            path = motion.preview(fly_by_setpoint(home, q, float(time) - earlier, model.limits), STEP)
            inside = np.linalg.norm(model.positions(path) - target, axis=1) <= tolerance
            entry = int(inside.argmax())
            if inside.any() and STEP * entry < best and model.are_free(path[: entry + 1]).all():
                best = STEP * entry
    return best


if __name__ == "__main__":
    typer.run(main)

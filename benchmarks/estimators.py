"""Time of estimation, prediction and safety filters in a decision: processor time of one robot, and filterpy's.

    python benchmarks/estimators.py [--steps 5000]

An observer takes the readings of a control step, and notes the command. A safety filter takes a random action. What
they take is recorded before they are timed.
"""

import itertools
import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import typer
from filterpy.kalman import KalmanFilter as FilterpyKalmanFilter
from printing import show, versioned_table

from armctl.core.arrays import Array
from armctl.envs import EpisodeVectorEnv, TaskVectorEnv, make_worlds
from armctl.estimation import ArmObserver, DriveObserver, KalmanFilter
from armctl.estimation.kalman import constant_velocity
from armctl.kernels.braking import ArmState
from armctl.kinematics import ArmModel
from armctl.policies.robot_filters import ArmFilterOptions, ArmFilters, Filters, RoverFilterOptions, RoverFilters

ARM_PERIOD, ROVER_PERIOD = 0.04, 0.1
NOISE = 0.01
"""m and rad."""
WARM_UP = 100
"""Control steps that are not timed."""

WORLDS, SEED = 50, 300
"""Episodes of filtered actions; they last 200 control steps or more."""

Step = Callable[[int], object]


def arm(moving: bool, steps: int) -> Step:
    """Observe an arm that moves between random configurations."""
    model, rng = ArmModel("ur5"), np.random.default_rng(0)
    observer = ArmObserver(model, ARM_PERIOD, moving)
    corners = model.random_configurations(rng, 2 + steps // 50)
    joints = np.concatenate([np.linspace(*pair, 50) for pair in itertools.pairwise(corners)])[:steps]
    tips = np.array([model.position(q) for q in joints]) + NOISE * rng.standard_normal((steps, 3))
    readings = joints + NOISE * rng.standard_normal(joints.shape)
    targets = 0.4 + NOISE * rng.standard_normal((steps, 3))
    velocity = np.zeros(3) if moving else None

    def step(i: int) -> None:
        observer.read(tips[i], readings[i], targets[i], velocity)
        observer.send(joints[i])

    return step


def rover(steps: int) -> Step:
    """Observe a rover whose commands change."""
    observer, rng = DriveObserver(1), np.random.default_rng(0)
    commands = np.column_stack((np.full(steps, 1.5), np.sin(np.arange(steps) / 5)))
    distance = ROVER_PERIOD * np.cumsum(commands[:, 0])
    yaws = ROVER_PERIOD * np.cumsum(commands[:, 1])
    states = np.column_stack((distance, np.zeros(steps), yaws, commands)) + NOISE * rng.standard_normal((steps, 5))

    def step(i: int) -> None:
        observer.observe(states[i : i + 1], noisy=True)
        observer.command(commands[i : i + 1])

    return step


def kalman_filter(steps: int) -> Step:
    """Filter six positions of constant velocity."""
    filters = KalmanFilter(constant_velocity(6, ARM_PERIOD, 8.0, NOISE))
    readings = NOISE * np.random.default_rng(0).standard_normal((steps, 1, 6))

    def step(i: int) -> None:
        filters.predict()
        filters.update(readings[i])

    return step


def arm_filter(steps: int) -> Step:
    """Filter random actions of arms among boxes."""
    worlds, rng = make_worlds("armctl/ArmReachObstacles-v0", WORLDS), np.random.default_rng(0)
    filters, timed = (ArmFilters(worlds.task, ArmFilterOptions()) for _ in range(2))
    low, high = worlds.task.action_range
    taken: list[Any] = []

    def act(i: int) -> Array:
        action, state = rng.uniform(low, high), filters.states()[i]
        taken.append((ArmState(*state.reshape(4, -1)), action))
        return filters.act(i, action, state)

    play(worlds, (filters, timed), act, steps)
    return lambda i: timed.filters[i % WORLDS](*taken[i])


def rover_filter(steps: int) -> Step:
    """Filter random actions of rovers among people."""
    worlds, rng = make_worlds("armctl/BridgeCrossMoving-v0", WORLDS), np.random.default_rng(0)
    assert isinstance(worlds, TaskVectorEnv)
    filters, timed = (RoverFilters(worlds, RoverFilterOptions()) for _ in range(2))
    low, high = worlds.task.action_range
    taken: list[Any] = []

    def act(i: int) -> Array:
        taken.append((*filters.inputs(i, filters.states()[i]), rng.uniform(low, high)))
        return filters.filters[i](*taken[-1])

    play(worlds, (filters, timed), act, steps)
    return lambda i: timed.filters[i % WORLDS](*taken[i])


def play(worlds: EpisodeVectorEnv, filters: tuple[Filters, Filters], act: Callable[[int], Array], steps: int) -> None:
    """Begin an episode in each of the worlds, and so many control steps in all, in each of which a world acts."""
    worlds.reset(seed=SEED)
    for some in filters:
        some.reset(np.arange(WORLDS, dtype=np.int32))
    for _ in range(math.ceil(steps / WORLDS)):
        worlds.step(np.array([act(i) for i in range(WORLDS)]))


def peer(steps: int) -> Step:
    """Filter them by filterpy."""
    model = constant_velocity(6, ARM_PERIOD, 8.0, NOISE)
    filters = FilterpyKalmanFilter(dim_x=12, dim_z=6)
    filters.F, filters.Q, filters.H, filters.R = (
        model.transition, model.process_noise, model.observation, model.reading_noise,
    )  # fmt: skip
    readings = NOISE * np.random.default_rng(0).standard_normal((steps, 6))

    def step(i: int) -> None:
        filters.predict()
        filters.update(readings[i])

    return step


def times_of(step: Step, steps: int) -> Array:
    """Return processor times (steps - `WARM_UP`,), us."""
    times = np.empty(steps)
    for i in range(steps):
        start = time.thread_time_ns()
        step(i)
        times[i] = time.thread_time_ns() - start
    return times[WARM_UP:] / 1e3


def main(steps: int = 5_000) -> None:
    """Time all, and print a table."""
    table = versioned_table("per control step", "median, us", "p99, us")
    for name, step in {
        "arm, target at rest": arm(False, steps),
        "arm, moving target": arm(True, steps),
        "rover": rover(steps),
        "safety filter, arm among boxes": arm_filter(steps),
        "safety filter, rover among people": rover_filter(steps),
        "Kalman filter, 12 states, 6 readings": kalman_filter(steps),
        "the same by filterpy": peer(steps),
    }.items():
        times = times_of(step, steps)
        table.add_row(name, f"{np.median(times):.0f}", f"{np.quantile(times, 0.99):.0f}")
    show(table)


if __name__ == "__main__":
    typer.run(main)

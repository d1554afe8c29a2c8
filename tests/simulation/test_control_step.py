"""Control steps in compiled code are those of `mujoco.batch`, bit for bit."""

from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.simulation import Simulation

from .batch_steps import BatchSteps

SMALL = {"resolution": (8, 6)}
CASES = [
    ("ArmReach-v0", {"control": "position"}),
    ("ArmReach-v0", {"control": "relative", "robot": "ur10"}),
    ("ArmReach-v0", {"control": "torque"}),
    ("ArmReach-v0", {"disturbances": {"payload": 2.0, "mismatch": 0.05, "pushes": 1.0}}),
    ("ArmReachMoving-v0", {"control": "velocity"}),
    ("ArmPose-v0", {"control": "position", "tolerance": 0.3, "angle_tolerance": 90.0}),
    ("ArmLift-v0", {"control": "position", "disturbances": {"strength": 0.8}}),
    ("ArmPush-v0", {"control": "relative", "disturbances": {"payload": 1.0}}),
    ("ArmReachObstacles-v0", {"control": "delta", "solvable": False}),
    ("ArmScenes-v0", {"solvable": False, "tolerance": 0.2, "angle_tolerance": 90.0}),
    ("BridgeCross-v0", SMALL),
    ("BridgeCrossMoving-v0", SMALL | {"disturbances": {"friction": 0.6}}),
]


def same(ours, theirs):
    if isinstance(ours, dict):
        assert ours.keys() == theirs.keys()
        for name in ours:
            same(ours[name], theirs[name])
    elif isinstance(ours, tuple):
        for one, other in zip(ours, theirs, strict=True):
            same(one, other)
    else:
        assert np.array_equal(ours, theirs, equal_nan=True)


def worlds(env, n, threads, options):
    made: Any = gymnasium.make_vec(f"armctl/{env}", num_envs=n, threads=threads, **options)
    return made, made.unwrapped.task


@pytest.mark.one_case
@pytest.mark.parametrize(("n", "threads"), [(1, 1), (5, 1), (5, 2)])
@pytest.mark.parametrize(("env", "options"), CASES)
def test_all_that_happens_is_the_same(env, options, n, threads):
    (ours, task), (theirs, other) = (worlds(env, n, threads, options) for _ in range(2))
    BatchSteps.take_over(other.simulation)
    output = "qfrc_bias" if options.get("control") == "torque" else "xpos"  # of the second, steps compute no forces
    outputs = [one.simulation.array(output) for one in (task, other)]
    ours.reset(seed=2)
    theirs.reset(seed=2)
    ours.action_space.seed(2)
    hit = False
    for k in range(60):
        actions = ours.action_space.sample()
        for simulation in (task.simulation, other.simulation):
            if k == 20 and "body_mass" in simulation._fields:
                simulation.per_world("body_mass")[0] *= 1.01
            if k == 30:
                simulation.array("qpos")[0] += 1e-3
            if k == 40:
                simulation.array("qvel")[n // 2] = 1e200
        same(ours.step(actions), theirs.step(actions))
        same(dict(task.simulation.live_arrays), dict(other.simulation.live_arrays))
        same(*outputs)
        assert np.array_equal(task.simulation.refined, other.simulation.refined)
        hit |= task.simulation.refined.any()
        running = ~ours.unwrapped._finished
        samples = (one.joints.since_last_step()[:, :, running] for one in (task, other))
        same(*samples)
        assert task.simulation.unstable[n // 2] == (k == 40)
    assert hit or n == 1


def test_it_needs_limits_to_speeds():
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    with pytest.raises(ConfigurationError, match="speed_limits"):
        Simulation(model, 2).control_step(1, 1)


def test_no_world_is_as_good_as_some():
    _, task = worlds("ArmReach-v0", 3, 2, {})
    before = task.simulation.live_arrays["state"].copy()
    task.advance(np.zeros(0, dtype=np.int32))
    assert np.array_equal(task.simulation.live_arrays["state"], before)


def test_a_fork_makes_its_own_threads(monkeypatch):
    _, task = worlds("ArmReach-v0", 8, 2, {})
    stepper = task.simulation._stepper
    threads = stepper._threads_of_process()
    assert stepper._threads_of_process() is threads
    monkeypatch.setattr("os.getpid", lambda: -5)
    assert stepper._threads_of_process() is not threads

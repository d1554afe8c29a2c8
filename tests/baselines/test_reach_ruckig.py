from typing import Any

import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.policies import make_policy
from armctl.robot_description import load_arm
from armctl.rollout import evaluate

REACH = "armctl/ArmReach-v0"
LIMITS = load_arm("ur5").limits


def commanded(disturbances, steps=20, worlds=4):
    """Commanded accelerations (steps + 1, worlds, 6) of some episodes, from rest on."""
    options = {"control": "velocity", "tolerance": 1e-3, "disturbances": disturbances}
    envs = make_worlds(REACH, worlds, options)
    policy: Any = make_policy("reach_ruckig", envs)
    observations, _ = envs.reset(seed=[100] * worlds, options={"episode": np.arange(worlds)})
    policy.reset(np.arange(worlds, dtype=np.int32))
    accelerations: list[Any] = [np.zeros((worlds, 6))]
    for _ in range(steps):
        observations, *_ = envs.step(policy.act(observations))
        accelerations.append([controller._motion.acceleration for controller in policy.controllers])
    return np.array(accelerations)


@pytest.mark.parametrize("disturbances", [{}, {"noise": 0.05}, {"pushes": 40}])
def test_the_commanded_motion_is_at_the_limit_of_jerk_and_never_beyond(disturbances):
    jerk = np.abs(np.diff(commanded(disturbances), axis=0)) / 0.04  # means over a control step
    assert (jerk <= LIMITS.jerk + 1e-6).all()
    assert jerk.max() > 0.99 * LIMITS.jerk.max()


@pytest.mark.parametrize("control", ["position", "relative", "delta", "velocity"])
def test_it_reaches_with_every_command_of_drives(control, sized):
    n = sized(10, 25)
    options = {"control": control}
    results = evaluate("reach_ruckig", episodes=n, seed=101, worlds=n, env_options=options, lower_bound_steps=False)
    assert results.success.all()


@pytest.mark.slow
@pytest.mark.parametrize("share", ["acceleration", "velocity"])
def test_gentler_motions_take_longer(share):
    def length(policy):
        results = evaluate(policy, episodes=8, seed=102, worlds=8, lower_bound_steps=False)
        assert results.success.all()
        return results.length.mean()

    assert length(f"reach_ruckig:{share}=0.3") > 1.3 * length("reach_ruckig")


@pytest.mark.slow
def test_it_stays_beside_a_moving_target(sized):
    n = sized(5, 12)
    env = "armctl/ArmReachMoving-v0"
    results = evaluate("reach_ruckig", env, episodes=n, seed=100, worlds=n, lower_bound_steps=False)
    assert results.success.all()
    assert results[results.success].tracking_error.mean() < 0.01


@pytest.mark.slow
def test_among_boxes_it_moves_only_where_it_is_free(sized):
    n = sized(8, 20)
    env = "armctl/ArmReachObstacles-v0"
    results = evaluate("reach_ruckig", env, episodes=n, seed=100, worlds=n, lower_bound_steps=False)
    assert (results.outcome == "reached").mean() >= 0.6
    assert (results.outcome == "collided").mean() <= 0.1


@pytest.mark.parametrize("first", [True, False])
def test_readings_that_are_no_numbers_are_left_out(first):
    envs = make_worlds(REACH, 1, {"control": "velocity"})
    policy: Any = make_policy("reach_ruckig", envs)
    observations, _ = envs.reset(seed=103)
    policy.reset(np.zeros(1, dtype=np.int32))
    for step in range(30):
        lost = np.full_like(observations, np.nan)
        action = policy.act(lost if step == (0 if first else 3) else observations)
        assert np.isfinite(action).all()
        observations, _, terminated, *_ = envs.step(action)
        if terminated[0]:
            break
    assert terminated[0]


def test_torques_are_refused():
    with pytest.raises(ConfigurationError, match="needs control"):
        make_policy("reach_ruckig", make_worlds(REACH, 1, {"control": "torque"}))

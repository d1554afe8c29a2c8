"""The arm's floors: resolved rate, and joint impedance in torques."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armctl.baselines.reach_rate import way_around
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.kinematics import ArmModel
from armctl.policies import make_policy
from armctl.policies.worlds import WorldsByInterface
from armctl.rollout import evaluate

REACH = "armctl/ArmReach-v0"


@pytest.mark.parametrize(("name", "control"), [("reach_rate", "velocity"), ("reach_impedance", "torque")])
def test_experts_play_with_the_control_that_they_declare_unless_another_is_requested(name, control):
    assert WorldsByInterface(REACH, 1).of(name).task.options.control == control
    assert WorldsByInterface(REACH, 1).of("reach_ik").task.options.control == "position"
    requested = WorldsByInterface(REACH, 1, {"control": "delta"}).of(name)
    assert requested.task.options.control == "delta"


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("name", "disturbances", "success"),
    [
        ("reach_rate", {}, 0.95),
        ("reach_impedance", {}, 0.95),
        ("reach_impedance", {"noise": 0.05}, 0.9),
        ("reach_impedance", {"mismatch": 0.2}, 0.9),
        ("reach_impedance", {"payload": 10}, 0.6),
    ],
)
def test_floors_reach(name, disturbances, success, sized):
    n, options = sized(10, 30), {"disturbances": disturbances}
    results = evaluate(name, episodes=n, seed=100, worlds=n, env_options=options, lower_bound_steps=False)
    assert results.success.mean() >= success


@pytest.mark.parametrize("control", ["position", "relative", "delta", "velocity"])
def test_resolved_rate_moves_the_tip_on_its_way_to_the_target(control):
    envs = make_worlds(REACH, 4, {"control": control})
    policy = make_policy("reach_rate", envs)
    observations, _ = envs.reset(seed=[100] * 4, options={"episode": np.arange(4)})
    for _ in range(4):
        before = observations.astype(float)
        observations, *_ = envs.step(policy.act(observations))
    moved = observations[:, :3] - before[:, :3]
    ways = np.array([way_around(row[:3], row[9:12]) for row in before])
    along = (moved * ways).sum(axis=1) / np.linalg.norm(ways, axis=1)
    assert (along > 0.8 * np.linalg.norm(moved, axis=1)).all()


@settings(max_examples=20, derandomize=True)
@given(st.lists(st.floats(-1, 1), min_size=6, max_size=6).map(np.array))
def test_the_way_around_leads_to_the_target_and_not_through_the_base(ends):
    tip, target = ends[:3].copy(), ends[3:]
    nearest = min(np.hypot(*tip[:2]), np.hypot(*target[:2]))
    for _ in range(800):
        tip += 0.02 * way_around(tip, target)
        assert np.hypot(*tip[:2]) > nearest - 1e-6
    np.testing.assert_allclose(tip, target, atol=1e-3)


def test_impedance_holds_a_payload_without_offset():
    """The disturbance observer's integral action: at rest, the deviation from the goal is zero."""
    envs = make_worlds(REACH, 2, {"control": "torque", "tolerance": 1e-3, "disturbances": {"payload": 5}})
    policy: Any = make_policy("reach_impedance", envs)
    observations, _ = envs.reset(seed=[103] * 2, options={"episode": np.arange(2)})
    policy.reset(np.arange(2, dtype=np.int32))
    for _ in range(80):
        observations, *_ = envs.step(policy.act(observations))
    goals = np.array([controller._goal for controller in policy.controllers])
    assert np.abs(observations[:, 3:9] - goals).max() < 0.02  # rad


def test_inertial_torques_are_the_mass_matrix_and_vanish_at_rest():
    model, rng = ArmModel("ur5"), np.random.default_rng(0)
    q, velocity = rng.uniform(-1, 1, (2, 6))
    rest = np.zeros(6)
    np.testing.assert_allclose(model.inertial_torques(q, rest, rest), 0.0, atol=1e-12)
    mass = np.array([model.inertial_torques(q, rest, unit) for unit in np.eye(6)])
    np.testing.assert_allclose(mass, mass.T, atol=1e-9)
    assert (np.linalg.eigvalsh(mass) > 0).all()
    coriolis = [model.inertial_torques(q, share * velocity, rest) for share in (1.0, 2.0)]
    np.testing.assert_allclose(coriolis[1], 4 * coriolis[0], rtol=1e-9)  # quadratic in the velocities


@pytest.mark.parametrize("name", ["reach_rate", "reach_impedance"])
def test_floors_survive_lost_readings(name):
    envs = WorldsByInterface(REACH, 1).of(name)
    policy = make_policy(name, envs)
    observations, _ = envs.reset(seed=104)
    policy.reset(np.zeros(1, dtype=np.int32))
    for step in range(6):
        action = policy.act(np.full_like(observations, np.nan) if step == 3 else observations)
        assert np.isfinite(action).all()
        observations, *_ = envs.step(action)


def test_impedance_needs_torques():
    with pytest.raises(ConfigurationError, match="'torque'"):
        make_policy("reach_impedance", make_worlds(REACH, 1))

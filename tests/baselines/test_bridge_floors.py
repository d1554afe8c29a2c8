"""Floors on the bridge: simple methods that see little, or plan little."""

from typing import Any

import gymnasium
import numpy as np
import pytest

from armctl.baselines.bridge_view import BridgeView
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.policies import make_policy

from .driving import MOVING, STATIC

RANGES: dict[str, Any] = {"dynamics": "kinematic", "observation": "ranges"}
FLOORS = ("bridge_pursuit", "bridge_dwa", "bridge_orca")


def crossed(name, seeds, **options):
    """Whether each of the bridges, without physics, is crossed."""
    env: Any = make_worlds(STATIC, len(seeds), {**RANGES, **options}, autoreset_mode="disabled")
    policy = make_policy(name, env)
    observations, _ = env.reset(seed=seeds)
    policy.reset(np.arange(len(seeds), dtype=np.int32))
    has_crossed = running = np.zeros(len(seeds), dtype=bool)
    running = ~running
    while running.any():
        observations, _, terminated, truncated, _ = env.step(policy.act(observations))
        has_crossed = has_crossed | (running & env.task.state.crossed)
        running = running & ~(terminated | truncated)
    return has_crossed


@pytest.mark.parametrize("name", FLOORS)
def test_they_cross_where_nothing_stands(name):
    assert crossed(name, [3], blocks=0, deck_length=10.0, missing_barriers=0).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bridge_dwa", "bridge_orca"])
def test_they_drive_around_blocks(name, sized):
    seeds = [100 + i for i in range(sized(3, 6))]
    assert crossed(name, seeds, deck_length=12.0, blocks=3).mean() > 0.6


def test_pursuit_stops_before_what_it_sees_and_goes_nowhere_else():
    env: Any = make_worlds(STATIC, 4, {**RANGES}, autoreset_mode="disabled")
    policy = make_policy("bridge_pursuit", env)
    observations, _ = env.reset(seed=5)
    policy.reset(np.arange(4, dtype=np.int32))
    for _ in range(250):
        observations, *_ = env.step(policy.act(observations))
    assert not env.task.state.collided.any()
    assert np.abs(env.task.state.poses[:, 1]).max() < 0.05
    assert (env.task.state.velocities == 0).all()


@pytest.mark.one_case
@pytest.mark.parametrize("name", FLOORS)
def test_they_repeat_in_any_number_of_worlds(name):
    def drive(seeds):
        env: Any = make_worlds(MOVING, len(seeds), {**RANGES}, autoreset_mode="disabled")
        policy = make_policy(name, env)
        observations, _ = env.reset(seed=seeds)
        policy.reset(np.arange(len(seeds), dtype=np.int32))
        for _ in range(25):
            observations, *_ = env.step(policy.act(observations))
        return env.task.state.poses

    np.testing.assert_array_equal(drive([3, 4, 5])[1], drive([4])[0])


@pytest.mark.parametrize("name", ["bridge_pursuit", "bridge_dwa"])
def test_readings_that_are_no_numbers_lead_to_no_wild_command(name):
    env: Any = make_worlds(STATIC, 1)
    policy = make_policy(name, env)
    observations, _ = env.reset(seed=1)
    policy.reset(np.zeros(1, dtype=np.int32))
    lost = {part: np.full_like(values, np.nan) for part, values in observations.items()}
    for readings in (observations, lost, observations, {**observations, "motion": lost["motion"]}):
        assert np.isfinite(policy.act(readings)).all()


@pytest.mark.parametrize("name", FLOORS)
def test_they_refuse_other_tasks(name):
    with pytest.raises(ConfigurationError, match="BridgeCross"):
        make_policy(name, gymnasium.make("armctl/ArmReach-v0"))


@pytest.mark.parametrize("name", ["bridge_pursuit", "bridge_dwa"])
def test_they_refuse_to_be_blind(name):
    with pytest.raises(ConfigurationError, match="depth image"):
        make_policy(name, make_worlds(STATIC, 1, {"observation": "state"}))


def test_what_is_out_of_view_is_remembered_for_a_while():
    env: Any = make_worlds(STATIC, 1, {"blocks": 0, **RANGES})
    view = BridgeView("it", env.task)
    columns = np.full(48, 10.0, dtype=np.float32)
    columns[24] = 2.0
    view.update({"motion": np.zeros(3), "ranges": columns}, memory=1.0)
    assert view.obstacles.shape == (1, 2)
    np.testing.assert_allclose(view.obstacles[0], (3.215, 0.0), atol=0.1)
    nothing, turned = np.full(48, 10.0, dtype=np.float32), 0
    while len(view.obstacles):
        view.update({"motion": np.array((0.0, 3.0, 3.0)), "ranges": nothing}, memory=1.0)
        turned += 1
        assert turned < 30
    assert turned == 1  # it looks there, and nothing is there
    view.update({"motion": np.array((0.0, 0.0, 0.0)), "ranges": columns}, memory=1.0)
    view.pose[2] += 2.0
    kept = 0
    while len(view.obstacles):
        view.update({"motion": np.zeros(3), "ranges": nothing}, memory=1.0)
        kept += 1
    assert kept == pytest.approx(11, abs=1)

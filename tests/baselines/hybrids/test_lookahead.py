from typing import Any

import numpy as np
import pytest

from armctl.baselines.hybrids.lookahead import ImaginedRovers, LookaheadOptions, LookaheadPolicy
from armctl.core.errors import ArmctlError, ConfigurationError
from armctl.envs import make_worlds
from armctl.policies import make_policy, sees
from armctl.tasks.bridge.observation import ROVER, WALKER
from armctl.tasks.bridge.planar import Geometry

ENV = "armctl/BridgeCrossMoving-v0"
STATE = {"observation": "state", "dynamics": "kinematic"}


class Card:
    memory = {}


class Straight:
    """An agent that drives straight ahead at full speed, whatever it sees."""

    sees, training_steps, training_cost, card = "state", 0, None, Card()

    def reset(self, ids):
        pass

    def act(self, observations):
        return np.tile(np.array([1.6, 0.0], np.float32), (len(observations), 1))


@pytest.fixture
def worlds():
    made = make_worlds(ENV, 16, STATE)
    yield made
    made.close()


def look(worlds, agent=None, **options):
    @sees("state")
    def factory(env):
        return LookaheadPolicy(agent or Straight(), env, LookaheadOptions(prepared=False, **options))

    return make_policy(factory, worlds)


def lengths(policy, worlds, seed=0, steps=60):
    """Control steps (n,) until the first contact of each world."""
    observations, _ = worlds.reset(seed=seed)
    policy.reset(np.arange(worlds.num_envs, dtype=np.int32))
    lasted, going = np.zeros(worlds.num_envs, int), np.ones(worlds.num_envs, bool)
    for _ in range(steps):
        observations, _, terminated, *_ = worlds.step(policy.act(observations).astype(np.float32))
        going &= ~terminated
        lasted += going
    return lasted


def imagined(worlds, states, steps=18):
    return ImaginedRovers(Geometry.of(worlds.task.options, worlds.task.simulation.model), states, steps)


@pytest.mark.parametrize(("slowest", "fastest"), [(0.4, 1.6), pytest.param(-1.6, 0.2, marks=pytest.mark.slow)])
def test_imagined_rovers_drive_as_those_without_physics_until_their_episodes_end(worlds, slowest, fastest):
    rng = np.random.default_rng(0)
    states, _ = worlds.reset(seed=3)
    rovers = imagined(worlds, states)
    for _ in range(18):
        commands = rng.uniform([slowest, -1.5], [fastest, 1.5], (16, 2)).astype(np.float32)
        going = rovers.active
        rovers.drive(commands.astype(float))
        states, _, terminated, *_ = worlds.step(commands)
        still = rovers.active
        np.testing.assert_array_equal(np.isin(going, still), ~terminated[going])
        np.testing.assert_allclose(rovers.states(still)[:, :ROVER], states[still, :ROVER], atol=1e-5)
    assert 0 < len(rovers.active) < 16
    assert (rovers.survival_steps[rovers.active] == 18).all()
    assert (rovers.survival_steps < 18).any()


@pytest.mark.parametrize("width", [3.2, 4.0])
def test_people_who_walk_across_are_where_they_are_imagined(width):
    worlds = make_worlds(ENV, 16, STATE | {"deck_width": width, "blocks": 0})
    states, _ = worlds.reset(seed=1)
    rovers, still = imagined(worlds, states, steps=40), np.zeros((16, 2))
    across = states[:, ROVER:].reshape(16, -1, WALKER)[..., 2] == 0  # they have no velocity along the bridge
    assert across.any()
    for _ in range(40):
        rovers.drive(still)
        states, *_ = worlds.step(still.astype(np.float32))
        found, expected = (
            seen[:, ROVER:].reshape(16, -1, WALKER)[across, :2] for seen in (rovers.states(np.arange(16)), states)
        )
        np.testing.assert_allclose(found, expected, atol=1e-4)
    worlds.close()


def test_rovers_that_have_crossed_are_not_driven_on(worlds):
    states, _ = worlds.reset(seed=0)
    states[:, 0] = worlds.task.goal_x - 0.5  # the front wheels are ahead of the rover's middle
    rovers = imagined(worlds, states)
    rovers.drive(np.tile([1.6, 0.0], (16, 1)))
    before = rovers.poses.copy()
    for _ in range(4):
        rovers.drive(np.tile([1.6, 0.0], (16, 1)))
    assert (rovers.poses[:, 0] < worlds.task.goal_x).all()
    assert (rovers.poses[:, 0] >= before[:, 0]).all()
    assert not len(rovers.active)
    assert (rovers.survival_steps == 18).all()


@pytest.mark.slow
def test_who_looks_ahead_lasts_longer(worlds):
    by_itself = look(worlds, linear=(1.6,), angular=(0.0,))  # there is nothing else to try
    alone, ahead = lengths(by_itself, worlds), lengths(look(worlds), worlds)
    assert (ahead >= alone).all()
    assert ahead.mean() > alone.mean() + 10


def test_without_danger_it_acts_as_the_agent(worlds):
    observations, _ = worlds.reset(seed=0)
    policy = look(worlds, steps=1)
    np.testing.assert_array_equal(policy.act(observations), Straight().act(observations))
    assert not policy.failures.any()


def test_it_counts_when_nothing_helps_and_not_after_a_contact(worlds):
    policy, counts = look(worlds, linear=(1.6,), angular=(0.0,)), []
    act = policy.act
    policy.act = lambda observations: (act(observations), counts.append(policy.failures.copy()))[0]
    lasted = lengths(policy, worlds)
    ended = np.flatnonzero(lasted < 60)
    assert len(ended)
    assert all(counts[lasted[world]][world] > 0 for world in ended)
    assert all(counts[-1][world] == counts[lasted[world]][world] for world in ended)


def test_a_world_s_commands_do_not_depend_on_the_others(worlds):
    observations, _ = worlds.reset(seed=0)
    together = look(worlds).act(observations)
    assert (together != Straight().act(observations)).any()
    for world in range(3):
        alone = make_worlds(ENV, 1, STATE)
        seen, _ = alone.reset(seed=int(worlds.seeds[world]))
        np.testing.assert_array_equal(look(alone).act(seen)[0], together[world])
        alone.close()


def test_it_sees_the_state_whatever_its_worlds_show():
    played = []
    for options in ({"resolution": (8, 6)}, {"observation": "state"}, {"disturbances": {"noise": 0.2}}):
        worlds = make_worlds(ENV, 2, options)
        observations, _ = worlds.reset(seed=0)
        policy: Any = make_policy("bridge_moving_imagined", worlds)
        policy._agent = Straight()  # which soon has to be stopped
        actions = []
        for _ in range(20):
            actions.append(policy.act(observations))
            observations = worlds.step(actions[-1].astype(np.float32))[0]
        played.append(actions)
        worlds.close()
    assert (np.array(played[0]) != [1.6, 0.0]).any()
    np.testing.assert_array_equal(played[0], played[1])
    np.testing.assert_array_equal(played[0], played[2])


def test_agents_with_a_memory_are_refused(worlds):
    class Remembering(Straight):
        card = type("", (), {"memory": {"hidden": [4]}})()

    with pytest.raises(ConfigurationError, match="without a memory"):
        look(worlds, Remembering())


def test_bridges_with_other_counts_are_refused():
    worlds = make_worlds(ENV, 1, {"walkers": 2})
    with pytest.raises(ArmctlError, match=r"maps observations .33. .* here they are .29."):
        make_policy("bridge_moving_imagined", worlds)
    worlds.close()


@pytest.mark.parametrize("options", [{"steps": 0}, {"held": 0}, {"linear": ()}, {"angular": ("fast",)}])
def test_options_out_of_range_are_refused(options):
    with pytest.raises(ConfigurationError, match=next(iter(options))):
        LookaheadOptions(**options)

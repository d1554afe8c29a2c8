import numpy as np
import pytest

from armctl.envs import make_worlds
from armctl.errors import ArmctlError, ConfigurationError
from armctl.policies import make_policy, sees
from armctl.rl.bridge_scans import OWN
from armctl.rl.looking_ahead import ImaginedRovers, LookAheadOptions, LookingAheadPolicy
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
        return np.tile(np.float32([1.6, 0.0]), (len(observations), 1))


@pytest.fixture
def worlds():
    made = make_worlds(ENV, 16, STATE)
    yield made
    made.close()


def look(worlds, agent=None, **options):
    @sees("state")
    def factory(env):
        return LookingAheadPolicy(agent or Straight(), env, LookAheadOptions(**options))

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


def test_imagined_rovers_drive_as_those_without_physics_until_they_touch_something(worlds):
    rng, task = np.random.default_rng(0), worlds.task
    states, _ = worlds.reset(seed=3)
    rovers = ImaginedRovers(task, Geometry(task.options, task.simulation.model), states)
    for _ in range(18):
        commands = rng.uniform([0.4, -1.5], [1.6, 1.5], (16, 2)).astype(np.float32)
        going = rovers.going
        rovers.drive(commands.astype(float))
        states, _, terminated, *_ = worlds.step(commands)
        still = rovers.going
        np.testing.assert_array_equal(np.isin(going, still), ~terminated[going])
        np.testing.assert_allclose(rovers.states(still)[:, :OWN], states[still, :OWN], atol=1e-5)
        expected, found = (part[:, -12:].reshape(-1, 3, 4) for part in (states[still], rovers.states(still)))
        np.testing.assert_allclose(
            found[..., 1], expected[..., 1], atol=0.03
        )  # along the bridge, some turn back sooner
    assert 0 < len(rovers.going) < 16
    assert (rovers.lasted[rovers.going] == 18).all()
    assert (rovers.lasted < 18).any()


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


def test_it_counts_when_nothing_helps(worlds):
    lasted = lengths(policy := look(worlds, linear=(1.6,), angular=(0.0,)), worlds)
    assert (policy.failures[lasted < 60] > 0).all()


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
    for options in ({"resolution": (8, 6)}, {"observation": "state"}):
        worlds = make_worlds(ENV, 2, options)
        observations, _ = worlds.reset(seed=0)
        found = make_policy("bridge_moving_imagined", worlds).act(observations)
        worlds.close()
        assert found.shape == (2, 2)
        expected = found if "resolution" in options else expected  # noqa: F821
        np.testing.assert_array_equal(found, expected)


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


@pytest.mark.parametrize("options", [{"steps": 0}, {"steps": 19}, {"held": 0}, {"margin": -0.1}])
def test_options_out_of_range_are_refused(options):
    with pytest.raises(ConfigurationError, match=next(iter(options))):
        LookAheadOptions(**options)

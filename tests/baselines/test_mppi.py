"""The sampling experts, and the simulator that one of them plans in."""

from contextlib import closing
from typing import Any

import gymnasium
import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.policies import make_policy
from armctl.rollout import evaluate

REACH, OBSTACLES, BRIDGE = "armctl/ArmReach-v0", "armctl/ArmReachObstacles-v0", "armctl/BridgeCross-v0"


def rate(policy, env, n, **options):
    return evaluate(policy, env, episodes=n, seed=7, worlds=n, lower_bound_steps=False, **options).success.mean()


def test_reach_mppi_reaches(sized):
    assert rate("reach_mppi", REACH, sized(4, 6)) >= 0.97


def test_reach_mppi_gets_around_boxes(sized):
    assert rate("reach_mppi", OBSTACLES, sized(3, 12)) >= 0.9


@pytest.mark.slow
def test_reach_mppi_follows_a_moving_target():
    assert rate("reach_mppi", "armctl/ArmReachMoving-v0", 3) >= 0.6


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["panda", "z1"])
def test_reach_mppi_reaches_with_other_arms(robot):
    assert rate("reach_mppi", REACH, 5, env_options={"robot": robot}) >= 0.9


@pytest.mark.slow
@pytest.mark.parametrize("env", [BRIDGE, "armctl/BridgeCrossMoving-v0"])
def test_bridge_mppi_crosses(env, sized):
    assert rate("bridge_mppi", env, sized(1, 5)) >= 0.9


@pytest.mark.parametrize(("name", "env"), [("reach_mppi", OBSTACLES), ("bridge_mppi", BRIDGE)])
def test_readings_that_are_no_numbers_or_jump_stop_no_sampling_expert(name, env):
    worlds = make_worlds(env, 2)
    observations, _ = worlds.reset(seed=0)
    policy: Any = make_policy(name, worlds)
    for step in range(6):
        if step == 3 and name == "reach_mppi":
            observations = np.asarray(observations) + np.float32(1.0)
        actions = policy.act(observations)
        assert np.isfinite(actions).all()
        observations, *_ = worlds.step(actions)
        if step == 4:
            policy.reset(np.array([1], dtype=np.int32))
            observations, _ = worlds.reset(options={"reset_mask": np.array([False, True])})


@pytest.mark.parametrize("name", ["reach_mppi", "bridge_mppi", "mppi"])
def test_other_tasks_are_refused(name):
    other = BRIDGE if name == "reach_mppi" else REACH
    with pytest.raises(ConfigurationError, match=name):
        make_policy(name, make_worlds(other, 1))


def third_party(env="Reacher-v5", **options):
    worlds: Any = make_worlds(env, 1, options=options)
    worlds.reset(seed=3)
    return worlds


@pytest.mark.parametrize("env", ["Reacher-v5", "Ant-v5", "Pendulum-v1"])
def test_what_is_imagined_happens_bit_for_bit(env):
    with closing(third_party(env)) as worlds:
        rng, space = np.random.default_rng(0), worlds.single_action_space
        worlds.step(space.sample()[None])
        imagined, before = worlds.imagined(0), worlds.task.observations[0].copy()
        actions = rng.uniform(space.low, space.high, (3, 5, *space.shape)).astype(np.float32)
        expected = imagined.returns(actions)
        np.testing.assert_array_equal(imagined.returns(actions[::-1]), expected[::-1])
        np.testing.assert_array_equal(worlds.task.observations[0], before)
        rewards = [worlds.step(action[None])[1][0] for action in actions[1]]
        assert sum(rewards) == expected[1]


class Chance(gymnasium.Env[Any, Any]):
    """A reward by chance, and one for each step of the action's size."""

    action_space = gymnasium.spaces.Box(-1, 1, (1,))
    observation_space = gymnasium.spaces.Box(-1, 1, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = []
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.steps.append(float(action[0]))
        return np.zeros(1, np.float32), float(self.np_random.random()), len(self.steps) == 3, False, {}


def test_chance_is_not_foreseen_and_lists_are_put_back():
    gymnasium.register("Chance-v5", Chance)  # type: ignore[arg-type]
    with closing(third_party("Chance-v5", max_episode_steps=5)) as worlds:
        foreseen = worlds.imagined(0).returns(np.zeros((2, 5, 1)))
        assert foreseen[0] == foreseen[1] < 3
        rewards = sum(worlds.step([[0.0]])[1][0] for _ in range(3))
        assert abs(rewards - foreseen[0]) > 1e-3
        assert len(worlds.worlds[0].unwrapped.steps) == 3


def test_an_environment_that_cannot_be_copied_says_so():
    with closing(third_party("Pendulum-v1")) as worlds:
        worlds.worlds[0].unwrapped.lock = (part for part in ())
        with pytest.raises(ConfigurationError, match="PendulumEnv cannot be copied"):
            worlds.imagined(0)


@pytest.mark.slow
def test_mppi_is_better_than_random(sized):
    n = sized(1, 2)
    for env, steps in (("Reacher-v5", 25), ("Pusher-v5", 20), ("InvertedPendulum-v5", 40)):
        options = {"max_episode_steps": steps if n == 1 else 2 * steps}
        comparison = armctl.compare(["mppi", "random"], env, episodes=n, env_options=options)
        mppi, random = comparison.policies
        assert mppi.episode_return.value > random.episode_return.value + 0.2 * abs(random.episode_return.value)
        assert comparison.facts.policies["mppi"].foresight == ("simulator",)


def test_mppi_refuses_actions_that_are_no_box():
    with pytest.raises(ConfigurationError, match="between bounds"):
        make_policy("mppi", third_party("CartPole-v1"))


def test_copies_are_for_who_declares_the_simulator():
    foreign = third_party()
    foreign.task.granted = ()
    for imagine in (lambda: foreign.imagined(0), foreign.model):
        with pytest.raises(ConfigurationError, match="nominal simulator is only for"):
            imagine()
    assert make_worlds("CartPole-v1", 1).foresight == ()


@pytest.mark.parametrize("level", ["payload", "mismatch"])
def test_the_nominal_model_has_no_disturbance(level):
    plain: Any = make_worlds(REACH, 1)
    disturbed: Any = make_worlds(REACH, 1, options={"disturbances": {level: 0.2 if level == "mismatch" else 2.0}})
    for worlds in (plain, disturbed):
        worlds.reset(seed=0)
    disturbed.task.simulation.data(0)  # as a picture does, with the world's own masses
    nominal, model = (worlds.model().mujoco for worlds in (plain, disturbed))
    for name in ("body_mass", "body_pos", "body_inertia"):
        np.testing.assert_array_equal(getattr(model, name), getattr(nominal, name))

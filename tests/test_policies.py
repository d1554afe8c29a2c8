from pathlib import Path

import gymnasium
import numpy as np
import pytest

from armctl.envs import ArmReachVectorEnv
from armctl.errors import ConfigurationError
from armctl.policies import Policy, make_policy, policy_names

ENV = "armctl/ArmReach-v0"


def stand_still(env):
    """A user's own policy, as `module:function`."""

    class StandStill:
        sees = "observation"
        training_steps = 0

        def reset(self, ids):
            pass

        def act(self, observations):
            return observations[:, 3:9]

    return StandStill()


def no_policy(env):
    return object()


@pytest.mark.parametrize("name", policy_names())
@pytest.mark.parametrize("worlds", [1, 5])
def test_installed_policies_act_in_batches(name, worlds):
    env = gymnasium.make_vec(ENV, num_envs=worlds)
    policy = make_policy(name, env)
    assert isinstance(policy, Policy)
    assert policy.sees == "observation"
    observations, _ = env.reset(seed=0)
    policy.reset(np.arange(worlds, dtype=np.int32))
    actions = policy.act(observations)
    assert actions.shape == (worlds, 6)
    assert np.isfinite(actions).all()


@pytest.mark.parametrize("name", policy_names())
def test_a_policy_decides_for_each_world_on_its_own(name):
    wide, narrow = ArmReachVectorEnv(6), ArmReachVectorEnv(1)
    observations, _ = wide.reset(seed=0)
    batched = make_policy(name, wide)
    batched.reset(np.arange(6, dtype=np.int32))
    actions = batched.act(observations)
    for world in (0, 5):
        alone = make_policy(name, narrow)
        observation, _ = narrow.reset(seed=world)
        alone.reset(np.zeros(1, dtype=np.int32))
        np.testing.assert_allclose(alone.act(observation)[0], actions[world], atol=1e-5)


def test_single_environments_and_users_functions_work_too():
    env = gymnasium.make(ENV)
    observation, _ = env.reset(seed=0)
    for policy in (stand_still, f"{__name__}:stand_still", stand_still(env)):
        action = make_policy(policy, env).act(observation[None])
        np.testing.assert_array_equal(action[0], observation[3:9])


@pytest.mark.parametrize(
    ("policy", "says"),
    [
        ("reach_ki", "Did you mean 'reach_ik'"),
        ("no.such.module:thing", "no.such.module"),
        (f"{__name__}:no_such_function", "no_such_function"),
        (no_policy, "no policy"),
    ],
)
def test_what_is_no_policy_is_named(policy, says):
    with pytest.raises(ConfigurationError, match=says):
        make_policy(policy, gymnasium.make(ENV))


def test_policies_need_an_armctl_environment():
    with pytest.raises(ConfigurationError, match="armctl's environments"):
        make_policy("random", gymnasium.make("CartPole-v1"))


def test_baselines_and_agents_are_plugins_that_the_core_does_not_name():
    import armctl

    core = Path(armctl.__file__).parent
    for file in core.rglob("*.py"):
        text = file.read_text()
        assert "armctl.baselines" not in text, file
        assert "armctl.rl" not in text, file

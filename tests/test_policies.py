import contextlib
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import armctl
from armctl.agents import read_card
from armctl.core.errors import ArmctlError, ConfigurationError
from armctl.core.registration import environment_names, installed
from armctl.envs import make_worlds
from armctl.policies import Policy, make_policy, policy_names
from armctl.policies.catalogue import listed_policies
from armctl.policies.declare import is_made_for
from armctl.policies.find import loaded
from armctl.policies.trainings import card_of, card_path
from armctl.study.line_up import default_policies
from armctl.study.results import read_comparison

from .holding_still import HoldsStill

ENV = "armctl/ArmReach-v0"
AGENTS = card_path("reach_ppo").parent


def stand_still(env):
    """A user's own policy, as `module:function`."""
    return HoldsStill()


def no_policy(env):
    return object()


SEEN = dict.fromkeys(
    (
        "reach_ik",
        "reach_mpc",
        "reach_ompl",
        "obstacles_imagined",
        "obstacles_plan_bc",
        "scenes_imagined",
        "scenes_plan_bc",
    ),
    "model",
)
SEEN |= dict.fromkeys(("moving_forecast", "moving_estimated", "bridge_cleaned"), "model")
SEEN |= dict.fromkeys(("moving_robust_distil", "obstacles_ppo", "obstacles_robust_distil"), "model")
SEEN |= dict.fromkeys(("lift_grasp", "push_line", "reach_impedance", "reach_rate", "reach_ruckig"), "model")
SEEN |= dict.fromkeys(("bridge_mpc", "bridge_ompl", "bridge_orca", "bridge_robust_ppo", "bridge_state_ppo"), "state")
SEEN |= dict.fromkeys(
    ("barn_moving_state_ppo", "barn_route_ppo", "bridge_moving_state_ppo", "bridge_moving_imagined", "bridge_mppi"),
    "state",
)
SEEN |= dict.fromkeys(("reach_mppi", "bridge_dwa", "bridge_lidar_ompl", "bridge_pursuit"), "model")
MEETINGS = [(name, env) for env in environment_names() for name in default_policies(env)]
EXPERTS = {policy.name: policy.envs for policy in listed_policies() if policy.kind in ("expert", "hybrid")}
FOREIGN = {name for name, envs in EXPERTS.items() if not any(is_made_for(env, envs) for env in environment_names())}
MEETINGS += [
    (name, min(env for env in environment_names() if is_made_for(env, envs)))
    for name, envs in EXPERTS.items()
    if name not in FOREIGN.union(dict(MEETINGS))
]
MEETINGS += sorted({(path.stem, read_card(path).env) for path in AGENTS.glob("*.json")} - set(MEETINGS))


def worlds_for(name, env_id, n):
    """Worlds with the interface that the policy was trained with, or that it declares."""
    card = AGENTS / f"{name}.json"
    options = read_card(card).env_options if card.exists() else getattr(loaded(name), "usual_interface", {})
    return gymnasium.make_vec(env_id, num_envs=n, **options)


@pytest.mark.one_case
@pytest.mark.parametrize(("name", "env_id"), MEETINGS)
@pytest.mark.parametrize("worlds", [1, 3])
def test_installed_policies_act_in_batches(name, env_id, worlds):
    env = worlds_for(name, env_id, worlds)
    policy = make_policy(name, env)
    assert isinstance(policy, Policy)
    assert policy.sees == SEEN.get(name, "observation")
    observations, _ = env.reset(seed=0)
    policy.reset(np.arange(worlds, dtype=np.int32))
    actions = policy.act(observations)
    assert actions.shape == env.action_space.shape
    assert np.isfinite(actions).all()


def test_all_installed_policies_meet_somewhere():
    assert {name for name, _ in MEETINGS} | FOREIGN == set(policy_names())


@pytest.mark.one_case
@pytest.mark.parametrize("name", [name for name in policy_names() if name != "random"])
def test_policies_of_another_task_say_so(name):
    env: Any = gymnasium.make_vec(ENV if name.startswith(("barn", "bridge")) else "armctl/BridgeCross-v0", num_envs=1)
    with pytest.raises(ArmctlError, match=r"BarnCross|BridgeCross|ArmLift|ArmPose|ArmPush|ArmReach|ArmScenes|Reacher"):
        make_policy(name, env)


@pytest.mark.one_case
@pytest.mark.parametrize(("name", "env_id"), MEETINGS)
def test_a_policy_decides_for_each_world_on_its_own(name, env_id):
    wide, narrow = (worlds_for(name, env_id, n) for n in (3, 1))
    observations, _ = wide.reset(seed=0)
    batched = make_policy(name, wide)
    batched.reset(np.arange(3, dtype=np.int32))
    actions = batched.act(observations)
    for world in (0, 2):
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
        (no_policy, "not a policy"),
    ],
)
def test_what_is_no_policy_is_named(policy, says):
    with pytest.raises(ConfigurationError, match=says):
        make_policy(policy, gymnasium.make(ENV))


def test_policies_need_an_armctl_environment():
    with pytest.raises(ConfigurationError, match="worlds that armctl has made"):
        make_policy("random", gymnasium.make("CartPole-v1"))


def test_baselines_and_agents_are_plugins_that_the_core_does_not_name():
    import armctl

    core = Path(armctl.__file__).parent
    for file in core.rglob("*.py"):
        text = file.read_text()
        assert "armctl.baselines" not in text, file
        assert "armctl.rl" not in text, file


def test_every_policy_that_comes_with_armctl_declares_its_family():
    families = {
        "ik": "IK", "mpc": "MPC", "ompl": "OMPL", "ppo": "PPO", "sac": "SAC", "bc": "BC", "dagger": "DAgger",
        "distil": "distillation", "imagined": "imagination", "random": None,
    }  # fmt: skip
    for name in policy_names():
        card = card_of(name)
        declared = card.family if card else getattr(installed("armctl.policies")[name].load(), "family", None)
        assert declared == families.get(name.rpartition("_")[2], declared), name
        assert declared or name == "random"


def test_a_policy_has_the_family_that_its_maker_declares():
    @armctl.sees("observation", family="PD")
    def still(observation):
        return observation[3:9]

    with contextlib.closing(make_worlds("armctl/ArmReach-v0", 1)) as worlds:
        policy: Any = make_policy(still, worlds)
        assert policy.family == "PD"
        assert not hasattr(make_policy(lambda observation: observation[3:9], worlds), "family")


def test_a_hybrid_is_one_because_its_maker_declares_it(tmp_path):
    @armctl.sees("observation", kind="hybrid")
    def still(observation):
        return observation[3:9]

    with pytest.raises(ConfigurationError, match=r"there is no kind 'hybird'\. Did you mean 'hybrid'"):
        armctl.sees("observation", kind="hybird")
    comparison = armctl.compare({"still": still, "hybrid": lambda seen: seen[3:9]}, episodes=2, worlds=2, out=tmp_path)
    for result in (comparison, read_comparison(tmp_path)):
        assert [policy.side for policy in result.policies] == ["hybrid", "classical"]

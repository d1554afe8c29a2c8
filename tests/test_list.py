"""`armctl list`: tasks with their policies, and all about one environment."""

import re

import pytest

from armctl.core.registration import environment_names
from armctl.envs.describe import describe_options
from armctl.envs.find import find_spec
from armctl.policies.catalogue import listed_policies, policies_of
from armctl.study.line_up import line_up

from .command_line import armctl, program


def test_list_shows_what_there_is(tmp_path):
    text = armctl("list", cwd=tmp_path).stdout
    for name in ("armctl/ArmReach-v0", "reach_ik", "reach_ppo", "random", "ur3", "ur5", "ur10", "ppo", "sac"):
        assert name in text
    assert re.search(
        r"\* reach_ik +expert +robot model +arms: not torque\n\* reach_ppo +agent, PPO +observation +ur5: position",
        text,
    )
    assert re.search(
        r"armctl/BridgeCross-v0  Drive across.*recipes +bridge_depth_ppo, .*armctl/BridgeCrossMoving-v0",
        text,
        re.DOTALL,
    )
    lines = program("list", cwd=tmp_path, COLUMNS="80").stdout.splitlines()
    assert max(map(len, lines)) <= 80


@pytest.mark.slow
def test_list_has_for_each_task_the_policies_that_can_act_in_it():
    policies = listed_policies()
    for env in (name for name in environment_names() if name.startswith("armctl/")):  # others' tests add more
        listed = {policy.name for policy in policies_of(find_spec(env), policies)}
        assert listed - {"random"} == set(line_up(env)) - {"random"}


@pytest.mark.parametrize(
    ("env", "words"),
    [
        ("armctl/ArmReach-v0", ("joint_positions  6", "tolerance = 0.05  float > 0. Radius of the target sphere, m",
                                "control = position  position | relative", "payload  a ball",
                                "ik  Minus the least time",
                                "max_episode_steps = 100", "reach_ik, reach_ppo, random",
                                "6 numbers of joint positions, rad: -6.", "joint_positions 6 rad",
                                "Move the end-effector",
                                "outcomes reached (success), timeout policies reach_ik Pinocchio IK",
                                "reward_weights = none")),
        ("armctl/BridgeCross-v0", ("image  32 x 48", "deck_length = 20.0  float >= 8 and <= 200. m.", "fell",
                                   "dropout  lost", "2 numbers")),
        ("armctl/BridgeCrossMoving-v0", ("walkers = 3  int >= 0 and <= 20. Person-sized",)),
        ("Pendulum-v1", ("g = 10.0", "max_episode_steps = 200", "1 number: -2 to 2")),
    ],
)  # fmt: skip
def test_list_shows_an_environment(env, words, tmp_path):
    text = " ".join(armctl("list", "--env", env, cwd=tmp_path).stdout.split())
    for word in words:
        assert " ".join(word.split()) in text


def test_every_option_of_every_environment_is_described():
    for env in (name for name in environment_names() if name.startswith("armctl/")):  # others' tests add more
        for option in describe_options(env):
            assert option.text, f"{env}: {option.name}"
            assert option.type, f"{env}: {option.name}"

"""Policies that a disturbance does not reach: what reads nothing of what it changes is spared, and never ranked."""

import dataclasses

import pytest

import armctl
from armctl.core.errors import ConfigurationError
from armctl.study import compare
from armctl.study.results import read_comparison
from armctl.verdict.pairs import verdict_pairs

from ..verdict.made_up_verdicts import played, text_of

BRIDGE = "armctl/BridgeCross-v0"
NOT_TESTED = "Not tested, because the disturbance does not affect them: reach_ik (noise)."


@pytest.fixture(scope="module")
def noisy(tmp_path_factory):
    folder = tmp_path_factory.mktemp("noisy")
    options = {"disturbances": {"noise": 0.05}, "max_episode_steps": 8}
    policies = ["bridge_mpc", "bridge_state_ppo", "bridge_ppo", "random"]
    return compare(policies, BRIDGE, episodes=2, env_options=options, out=folder), folder


def test_who_reads_no_observation_is_spared_its_noise(noisy):
    found, folder = noisy
    spared = {"bridge_mpc": ("noise",), "bridge_state_ppo": (), "bridge_ppo": (), "random": ("noise",)}
    assert {one.policy: one.spared for one in found.policies} == spared
    assert {one.policy: tuple(one.spared) for one in read_comparison(folder).policies} == spared


def test_no_pair_with_a_spared_policy_is_tested_or_told(noisy):
    found, _ = noisy
    assert [{pair.a, pair.b} for pair in found.differences] == [{"bridge_state_ppo", "bridge_ppo"}]
    assert found.verdict.context.endswith(
        "because the disturbance does not affect them: bridge_mpc (noise), random (noise)."
    )
    table = found.document().tables[0]
    assert [row[0].small.endswith("spared noise") for row in table.rows] == [True, False, False, True]
    assert "Spared: not affected" in table.caption


@pytest.mark.parametrize("baseline", [None, "reach_ik"])
def test_a_spared_winner_does_not_win(baseline):
    """However far it is ahead; and where it is the baseline, nobody is held against it."""
    wins = {"reach_ik": range(400), "reach_ppo": range(300), "reach_mpc": range(200)}
    policies, pairs = played(wins)
    policies = [dataclasses.replace(one, spared=("noise",) if one.policy == "reach_ik" else ()) for one in policies]
    pairs = [pair for pair in pairs if "reach_ik" not in (pair.a, pair.b)]
    told = verdict_pairs(policies, pairs, baseline)
    assert [(one.first.policy, one.second.policy) for one in told] == ([] if baseline else [("reach_ppo", "reach_mpc")])
    said = text_of(policies, pairs, baseline)
    assert said.endswith(NOT_TESTED)
    assert "reach_ik" not in said.removesuffix(NOT_TESTED)
    assert said.startswith("Not tested" if baseline else "reach_ppo is better than reach_mpc")


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("sees", "reads", "spared"),
    [
        ("observation", None, ()),
        ("map", None, ()),
        ("state", None, ("noise", "dropout")),
        ("state", ("observation", "state"), ()),
        ("observation", (), ("noise", "dropout")),
    ],
)
def test_a_policy_may_say_what_it_reads(sees, reads, spared):
    class Still:
        training_steps = 0

        def __init__(self, env):
            self.n = env.num_envs

        def reset(self, ids):
            pass

        def act(self, observations):
            return [[0.0, 0.0]] * self.n

    armctl.sees(sees)(Still)
    if reads is not None:
        Still.reads = reads  # type: ignore[attr-defined]
    options = {"disturbances": {"noise": 0.1, "delay": 1, "dropout": 0.5}, "max_episode_steps": 2}
    (only,) = compare(Still, BRIDGE, episodes=1, env_options=options).policies
    assert only.spared == spared


def test_an_unknown_channel_is_an_error():
    def still(observation):
        return [0.0] * 6

    still.reads = ("pictures",)  # type: ignore[attr-defined]
    with pytest.raises(ConfigurationError, match="no channel that a policy reads 'pictures'"):
        compare(still, episodes=1, env_options={"max_episode_steps": 1})

import io
import json

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

import armctl
from armctl.episodes.record import COLUMNS, TIME_COLUMNS
from armctl.kinematics import ArmModel
from armctl.planning import PathCertificate, PathCertificateOptions
from armctl.report.terminal import tables
from armctl.rollout import evaluate
from armctl.study import compare
from armctl.tasks import ReachObstaclesTask
from armctl.verdict.sentences import verdict

from ..printed import text_of

TIMES = list(TIME_COLUMNS)
BOX = {"target": "box", "max_episode_steps": 30}


def test_every_policy_meets_the_same_episodes(sized, tmp_path):
    count = sized(4, 12)
    comparison = compare(["reach_ik", "reach_ppo", "random"], episodes=count, seed=3, out=tmp_path)
    episodes = pd.read_csv(tmp_path / "episodes.csv")
    assert tuple(episodes.columns) == COLUMNS
    assert len(episodes) == 3 * count
    for _, group in episodes.groupby("policy"):
        assert sorted(group.episode) == list(range(count))
    assert (episodes.seed == 3).all()
    pd.testing.assert_frame_equal(episodes, comparison.episodes)
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert [policy["policy"] for policy in summary["policies"]] == ["reach_ik", "reach_ppo", "random"]
    assert summary["policies"][1]["training"]["decisions"] > 0
    assert {"mujoco", "pin", "armctl-suite", "python"} <= set(summary["versions"])
    assert len(summary["differences"]) == 3


def test_an_episode_of_the_table_can_be_played_again():
    import gymnasium

    row = evaluate("reach_ik", episodes=6, seed=2).iloc[4]
    env = gymnasium.make("armctl/ArmReach-v0")
    policy = armctl.make_policy("reach_ik", env)
    observation, _ = env.reset(seed=int(row.seed), options={"episode": int(row.episode)})
    total, length, finished = 0.0, 0, False
    while not finished:
        observation, reward, terminated, truncated, _ = env.step(policy.act(observation[None])[0])
        total, length, finished = total + float(reward), length + 1, terminated or truncated
    assert (total, length) == (row["return"], row.length)


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["reach_ik", "random"])
def test_number_of_worlds_changes_no_episode(policy):
    options = {"max_episode_steps": 40}
    runs = [
        evaluate(policy, episodes=11, seed=1, worlds=worlds, env_options=options).drop(columns=TIMES)
        for worlds in (1, 4, 64)
    ]
    assert runs[0].equals(runs[1])
    assert runs[0].equals(runs[2])


def test_returns_and_lengths_agree_with_the_reward():
    episodes = evaluate("reach_ppo", episodes=30, worlds=7)
    won = episodes[episodes.success]
    assert len(won) > 20
    assert (won["return"] == 100 - won.length).all()
    lost = evaluate("random", episodes=10, worlds=10).query("not success")
    assert (lost["return"] == -100).all()
    assert (lost.length == 100).all()


def test_infeasible_episodes_are_told_apart():
    comparison = compare(["reach_ik"], episodes=12, worlds=12, env_options=BOX)
    summary = comparison.policies[0]
    assert 0 < summary.infeasible < 12
    assert summary.episodes == 12 - summary.infeasible
    assert summary.success.value == 1
    assert f"{summary.infeasible} episodes are labelled infeasible" in text_of(comparison)


@pytest.mark.slow
def test_labels_do_not_depend_on_the_line_up(monkeypatch):
    """An episode that the certificate gave up counts for nobody, though the expert wins it; a remark tells so."""
    starved = PathCertificate(ArmModel("ur5"), PathCertificateOptions(checks=60))
    monkeypatch.setattr(ReachObstaclesTask, "_certificate", starved)
    monkeypatch.setattr(ReachObstaclesTask, "_pool", None)
    env, unsolved = "ArmReachObstacles-v0", {"solvable": False, "max_episode_steps": 60}
    alone = compare(["random"], env, episodes=6, worlds=6, env_options=unsolved)
    both = compare(["reach_ompl", "random"], env, episodes=6, worlds=6, env_options=unsolved)
    assert 0 < alone.policies[0].infeasible < 6
    assert {one.infeasible for one in both.policies} == {alone.policies[0].infeasible}
    assert alone.policies[0].episodes == both.policies[1].episodes == 6 - alone.policies[0].infeasible
    won = both.episodes.query("success and not feasible")
    assert len(won) > 0
    assert f"{len(won)} episodes labelled infeasible were won ({len(won)} by reach_ompl)" in " ".join(both.notes)
    assert "too strict" not in " ".join(alone.notes)


def test_all_figures_are_over_the_same_feasible_episodes():
    comparison = compare(["reach_ik", "random"], episodes=12, worlds=12, env_options=BOX)
    ik, random = comparison.policies
    (pair,) = comparison.differences
    assert ik.episodes == random.episodes == pair.episodes == 12 - ik.infeasible < 12
    assert pair.only_a - pair.only_b == pytest.approx(pair.episodes * (ik.success.value - random.success.value))


@armctl.sees("state")
def winning_every_second(env):
    """Holds still in every second episode, and fails after the seventh decision there."""
    expert = armctl.make_policy("reach_ik", env)

    class EverySecond:
        sees = "observation"
        training_steps = 0

        def reset(self, ids):
            expert.reset(ids)

        def act(self, observations):
            actions = expert.act(observations)
            for world, episode in enumerate(env.episodes):
                if episode % 2:
                    actions[world] = observations[world, 3:9]
            if env.episodes.max() > 14:
                raise RuntimeError("out of ideas")
            return actions

    return EverySecond()


@pytest.mark.slow
def test_a_policy_that_fails_late_is_judged_by_all_episodes():
    comparison = compare([winning_every_second, "random"], episodes=20, worlds=5)
    summary = comparison.policies[0]
    assert summary.episodes == 20
    assert summary.outcomes["error"] >= 5
    assert summary.success.value <= 0.4
    assert "was cut short" not in text_of(comparison)


def test_policies_may_be_functions_or_a_single_name(tmp_path):
    compare([winning_every_second], episodes=2, out=tmp_path)
    assert pd.read_csv(tmp_path / "episodes.csv").policy.unique().tolist() == ["winning_every_second"]
    assert compare("random", episodes=1).policies[0].policy == "random"


def test_no_verdict_from_few_episodes():
    assert "No verdict from 3 episodes" in text_of(compare(["reach_ik", "random"], episodes=3))


def test_tables_fit_a_narrow_terminal():
    text = text_of(compare(["reach_ik", "reach_ppo", "random"], episodes=5))
    assert "…" not in text
    for word in ("reach_ppo", "observation", "100.0 %", "Paired differences"):
        assert word in text


@pytest.mark.slow
def test_verdict_names_the_better():
    comparison = compare(["random", "reach_ik"], episodes=12)
    sentence = verdict(comparison.policies, comparison.differences).result
    assert sentence.startswith("reach_ik is better than random: success +100.0 points [")


def test_the_bridge_is_compared_like_the_arm_and_endings_are_told(sized):
    count = sized(1, 4)
    comparison = compare(
        ["bridge_ompl", "random"], "armctl/BridgeCross-v0", episodes=count, env_options={"resolution": (4, 4)}
    )
    expert, random = comparison.policies
    assert (expert.sees, random.sees) == ("state", "observation")
    assert expert.outcomes == {"crossed": count}
    assert sum(random.outcomes.values()) == count
    assert "crossed" not in random.outcomes
    assert f"bridge_ompl: {count} crossed" in text_of(comparison)


def test_gap_is_to_the_least_length_that_all_policies_share(tmp_path):
    comparison = compare(["reach_ik", "reach_ppo"], episodes=20, worlds=5, out=tmp_path)
    episodes = pd.read_csv(tmp_path / "episodes.csv")
    least = episodes.pivot_table(index="episode", columns="policy", values="lower_bound_steps")
    assert (least.reach_ik == least.reach_ppo).all()
    assert (episodes.length >= episodes.lower_bound_steps - 1).all()
    won = episodes[episodes.success]
    np.testing.assert_allclose(won.optimality_gap, won.length / won.lower_bound_steps - 1)
    for policy in comparison.policies:
        assert policy.optimality_gap.value == pytest.approx(won[won.policy == policy.policy].optimality_gap.median())
        assert policy.tracking_error is None
    console = Console(file=(out := io.StringIO()), width=100)
    console.print(tables(comparison))
    assert "% over the least time" in out.getvalue()


def test_zeros_are_no_proof_of_none():
    """What has no bounds has no interval; contacts have the time limit as one."""
    found = compare(["random", "reach_ik"], episodes=12, worlds=12, env_options={"max_episode_steps": 9})
    for one in found.policies:
        contacts = one.metrics["contacts"]
        assert contacts is None or 0 <= contacts.low <= contacts.value < contacts.high <= 9
        assert one.metrics["energy"] is None or one.metrics["energy"].low is None
        assert one.decision_seconds.low is None


def test_failures_have_no_gap():
    episodes = evaluate("random", episodes=3, env_options={"max_episode_steps": 5})
    assert episodes.optimality_gap.isna().all()
    assert (episodes.lower_bound_steps >= 1).all()

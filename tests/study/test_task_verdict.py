"""What the suite says of each task, and of all of them."""

import importlib
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from armctl.episodes.stored import UNDISTURBED
from armctl.report.suite_page import write_suite_page
from armctl.stats.across_tasks import Choice, TaskPair, pairwise_by_task
from armctl.stats.correction import holm
from armctl.stats.intervals import Estimate, bounded_difference
from armctl.stats.paired import mcnemar
from armctl.study import Study, sweep
from armctl.study.suite_headline import suite_headline
from armctl.study.suite_tables import success_test, task_table
from armctl.study.task_verdict import TaskVerdict, holm_corrected, task_verdict

from ..report.pages import text_of
from ..verdict.made_up_verdicts import summary_of

SETTINGS = ("delay 1", "noise 0.1")


def head(only_classical, only_learned, episodes=50, p=None):
    p = mcnemar(only_classical, only_learned) if p is None else p
    return TaskPair(episodes, only_classical, only_learned, p)


TIME = "0.25 ms (99th percentile 0.5 ms)"


def answer_of(undisturbed, *disturbed, env="armctl/Some-v0", timing=((1, 1), (1, 1))):
    policies = [
        replace(summary_of(name, np.ones(1, dtype=bool)), worlds=worlds, workers=workers)
        for name, (worlds, workers) in zip(("reach_ik", "reach_ppo"), timing, strict=True)
    ]
    heads = {UNDISTURBED: undisturbed, **dict(zip(SETTINGS, disturbed, strict=False))}
    return TaskVerdict(
        env, policies, {}, {name: name for name in heads}, Choice("reach_ik"), Choice("reach_ppo"), heads
    )


@pytest.mark.parametrize(("wins", "losses"), [(8, 0), (0, 8)])
def test_few_episodes_give_no_verdict_anywhere(wins, losses):
    eight = head(wins, losses, episodes=8)
    assert eight.p < 0.05
    (one,) = holm_corrected([answer_of(eight, head(losses, wins, episodes=8))])
    assert one.verdict.startswith("No verdict from 8 episodes")
    assert one.reversals == ""
    assert suite_headline([one]) == ("Of 1 task, by success: no verdict in Some", "Some: 8 episodes")


def test_verdicts_and_headline_are_corrected_for_all_tasks_and_for_success_and_steps():
    faster = {"steps": Estimate(-2.3, -4.2, -0.3), "steps_p": 0.012}
    heads = [head(6, 0), head(0, 12), head(8, 1), replace(head(3, 3), **faster)]
    answers = [answer_of(one, head(0, 20), env=f"armctl/Task{i}-v0") for i, one in enumerate(heads)]
    found = holm_corrected([*answers, TaskVerdict("armctl/None-v0", [], {}, {})])
    tests = holm([*(one.p for one in heads), 0.012])
    assert [one.undisturbed.p for one in found[:-1]] == tests[:4]
    assert found[3].undisturbed.steps_p == tests[4] == pytest.approx(0.048)
    assert [one.undisturbed.num_comparisons for one in found[:-1]] == [4] * 4
    assert [one.undisturbed.better for one in answers] == [1, -1, 1, 0]
    assert [one.undisturbed.better for one in found[:-1]] == [0, -1, 0, 0]
    assert [one.verdict.partition(":")[0] for one in found[:-1]] == [
        "Undecided", "Learned is better", "Undecided", "Undecided",
    ]  # fmt: skip
    assert found[3].verdict.endswith("; classical takes 2.3 [0.3, 4.2] fewer steps, p = 0.048")
    assert suite_headline(found) == (
        "Of 5 tasks, by success: learned is better in Task1; undecided in Task0, Task2 and Task3; no verdict in None",
        "Task0: up to 26.2 points apart after 50 episodes; Task2: up to 29.3 points apart after 50 episodes; Task3: up "
        "to 13.5 points apart after 50 episodes; None: no episode was finished undisturbed; classical takes fewer "
        "steps in Task3",
    )
    assert found[0].pairs[SETTINGS[0]] == answers[0].pairs[SETTINGS[0]]


def test_the_answers_of_a_suite_are_corrected_for_all_its_tasks(monkeypatch):
    module = importlib.import_module("armctl.study.study")
    heads = {f"armctl/Task{i}-v0": head(6, 0) for i in range(3)}
    monkeypatch.setattr(module, "task_verdict", lambda env: answer_of(heads[env], env=env))
    found = module.Study("suite", 0, 50, [], False, {env: env for env in heads}, {}, False).verdicts
    assert [one.undisturbed.p for one in found] == holm([mcnemar(6, 0)] * 3)
    assert [(one.undisturbed.better, one.undisturbed.num_comparisons) for one in found] == [(0, 3)] * 3


def test_steps_are_told_where_neither_is_better_in_success():
    slower = {"steps": Estimate(2.34, 0.26, 4.2), "steps_p": 0.01}
    equal = answer_of(replace(head(0, 0, episodes=500), **slower))
    assert equal.verdict == (
        "Equivalent in success within 2 points: reach_ik against reach_ppo, +0.0 points [-0.7, 0.7]; "
        "learned takes 2.3 [0.3, 4.2] fewer steps, p = 0.01"
    )
    for untold in ({"steps_p": 0.06}, {"steps": Estimate(2.34, -0.1, 4.2)}, {"episodes": 9}):
        assert replace(equal.undisturbed, **untold).faster == 0
    better = replace(head(12, 0), **slower)
    assert (better.better, better.faster) == (1, 0)
    assert "steps" not in answer_of(better).verdict


def test_earlier_looks_are_a_part_of_verdict_and_headline():
    words = "after 2 earlier looks at 20 and 50 episodes, p is too small and intervals are too narrow"
    one = replace(answer_of(head(20, 0)), looks=[20, 50])
    assert one.verdict.endswith(f"p = 1.9e-06; {words}")
    assert suite_headline([one, replace(one, looks=[50])]) == (
        "Of 2 tasks, by success: classical is better in Some and Some",
        words,
    )


def swept(gains):
    """An answer from differences in success by setting: -1, 0 or 1 for each episode."""
    cells = {name: pd.DataFrame({"c": gain > 0, "l": gain < 0}, dtype=float) for name, gain in gains.items()}
    heads = pairwise_by_task(cells, UNDISTURBED, Choice("c"), Choice("l"))
    return TaskVerdict("armctl/Some-v0", [], cells, {name: name for name in cells}, Choice("c"), Choice("l"), heads)


def lead(won, lost, episodes=100):
    return np.repeat([1, -1, 0], [won, lost, episodes - won - lost])


def test_the_order_turns_where_the_change_is_significant():
    one = swept({UNDISTURBED: lead(20, 0), "noise 1": lead(0, 20)[::-1], "delay 1": lead(20, 0), "delay 2": lead(4, 0)})
    assert one.reversals == (
        "the order reverses: learned is better with noise 1 (-20.0 points [-29.2, -11.8]); the difference shifts "
        "towards learned with delay 2 (by 16.0 [6.0, 26.9] points); not shown to change in the other disturbed setting"
    )
    same = swept({UNDISTURBED: lead(20, 0), **{f"delay {i}": lead(20, 0) for i in range(3)}})
    assert same.reversals == "not shown to change in any of the 3 disturbed settings"
    grown = swept({UNDISTURBED: lead(2, 2), "noise 1": lead(40, 0)})
    assert grown.reversals == "the difference shifts towards classical with noise 1 (by 40.0 [26.5, 52.1] points)"


def test_a_difference_that_is_significant_and_one_that_is_not_are_no_change():
    before, after = lead(8, 1), lead(3, 2)  # p = 0.04 and 1
    one = swept({UNDISTURBED: before, "noise 1": after})
    assert one.undisturbed.better == 1
    assert one.pairs["noise 1"].better == 0
    assert one.reversals == "not shown to change in the disturbed setting"
    other = swept({UNDISTURBED: lead(2, 3), "noise 1": lead(1, 8)})
    assert other.pairs["noise 1"].better == -1
    assert other.reversals == "not shown to change in the disturbed setting"


def test_two_opposite_leads_turn_nothing_unless_the_change_itself_is_significant():
    before, after = head(20, 0), head(0, 20)
    assert (before.better, after.better) == (1, -1)
    for change, p in ((None, None), (Estimate(-0.8, -1.0, -0.6), 0.06), (Estimate(-0.8, -1.0, 0.1), 0.01)):
        one = answer_of(before, replace(after, change=change, change_p=p))
        assert one.reversals == "not shown to change in the disturbed setting"
    shown = replace(after, change=Estimate(-0.8, -1.0, -0.6), change_p=0.01)
    assert answer_of(before, shown).reversals.startswith(
        "the order reverses: learned is better with delay 1 (-40.0 points ["
    )


def test_changes_are_paired_and_corrected_for_all_disturbed_settings():
    gains = {UNDISTURBED: lead(10, 0), **{f"delay {i}": lead(5, i)[::-1] for i in range(3)}}
    one = swept(gains)
    raw = [bounded_difference((gains[name] - gains[UNDISTURBED]).astype(float), (-2.0, 2.0)) for name in gains][1:]
    found = [one.pairs[name] for name in list(gains)[1:]]
    assert [head.change for head in found] == [change.estimate for change in raw]
    assert [head.change_p for head in found] == holm([change.p for change in raw])
    assert one.undisturbed.change is None
    few = swept({UNDISTURBED: lead(9, 0, 9), "delay 1": lead(0, 9, 9)})
    assert few.pairs["delay 1"].changed == 0


@pytest.mark.one_case
@pytest.mark.parametrize("edge", [0.0, 0.2])
def test_equal_effects_turn_in_five_of_a_hundred_tasks_at_most(edge, sized):
    # By significance here and not there, 92 % of tasks with an edge of 20 points had lost it somewhere, or won it.
    rng, runs, wrong = np.random.default_rng(0), sized(30, 100), 0
    for _ in range(runs):
        settings = (UNDISTURBED, *(f"noise {i}" for i in range(6)))
        one = swept({name: rng.choice([1, -1, 0], 50, p=[0.2 + edge / 2, 0.2 - edge / 2, 0.6]) for name in settings})
        wrong += one.reversals != "not shown to change in any of the 6 disturbed settings"
    assert wrong / runs <= 0.05 + 2 * (0.05 * 0.95 / runs) ** 0.5


@pytest.mark.parametrize(
    ("timing", "said"),
    [
        (((1, 1), (1, 1)), f"reach_ik {TIME}, reach_ppo {TIME}."),
        (((4, 1), (4, 1)), f"reach_ik {TIME}, reach_ppo {TIME} (shares of a batch of 4 worlds)."),
        (((1, 1), (4, 1)), f"reach_ik {TIME} (latency), reach_ppo {TIME} (shares of a batch of 4 worlds)."),
        (
            ((2, 1), (4, 1)),
            f"reach_ik {TIME} (shares of a batch of 2 worlds), reach_ppo {TIME} (shares of a batch of 4",
        ),
    ],
)
def test_what_decision_times_are_is_said_of_whom_it_is_true(timing, said):
    assert said in answer_of(head(3, 3), timing=timing).costs


@pytest.mark.slow
def test_a_setting_that_spares_who_stands_for_a_kind_is_not_compared(tmp_path):
    """The expert reads the true state, which noise leaves alone: no head, and `spared` on the map."""
    env = "armctl/BridgeCross-v0"
    swept = sweep(
        ["bridge_mpc", "bridge_state_ppo"], env, disturbances={"noise": [0.5], "payload": [5]}, episodes=2,
        env_options={"max_episode_steps": 3},
    )  # fmt: skip
    found = task_verdict(swept)
    assert list(found.pairs) == list(found.shared_cells) == [UNDISTURBED, "payload-5.0"]
    assert list(found.cells["noise-0.5"]) == ["bridge_state_ppo"]
    assert found.not_compared == "Not compared: noise 0.5 (spares bridge_mpc)."
    assert found.not_compared in found.context
    page = tmp_path / "page.html"
    write_suite_page(Study("suite", 0, 2, [env], False, {env: swept}, {}, False), tmp_path, page, {})
    assert "bridge_mpc 0 spared 0" in text_of(page)


def test_steps_of_a_task_are_a_bounded_paired_difference():
    swept = sweep(["reach_ik", "reach_ppo"], disturbances={"noise": [0.01]}, episodes=12, worlds=12)
    steps = swept.comparisons[UNDISTURBED].episodes.pivot(index="episode", columns="policy", values="length")
    found = task_verdict(swept).undisturbed
    gains = (steps.reach_ik - steps.reach_ppo).to_numpy(float)
    assert gains.min() > -99  # so that the bounds are the time limit's, not what was seen
    expected = bounded_difference(gains, (-99.0, 99.0))
    assert (found.steps, found.steps_p) == (expected.estimate, expected.p)


@pytest.mark.slow
def test_the_best_hybrid_is_compared_with_the_best_of_both_other_kinds():
    def still(seen):
        return seen[3:9]

    swept = sweep(["reach_ik", "reach_ppo", still], disturbances={"noise": [0.01]}, episodes=12, worlds=12)
    for comparison in swept.comparisons.values():
        facts = comparison.facts.policies
        facts["reach_ik"] = replace(facts["reach_ik"], kind="hybrid")
    (found,) = holm_corrected([task_verdict(swept)])
    assert (found.hybrid.policy, found.classical.policy, found.learned.policy) == ("reach_ik", "still", "reach_ppo")
    against = {kind: pairs[UNDISTURBED] for kind, pairs in found.hybrid_pairs.items()}
    assert [against[kind].better for kind in ("classical", "learned")] == [1, 0]
    assert against["learned"].steps.value == -task_steps(swept, "reach_ppo", "reach_ik")
    assert found.undisturbed.num_comparisons == 3
    text = found.of_hybrid
    assert text.startswith("Hybrid reach_ik against classical still: better undisturbed (+")
    assert "; better with noise 0.01 (+" in text
    assert "Hybrid reach_ik against learned reach_ppo: not shown to be better or worse undisturbed (" in text
    assert text in found.context
    table = task_table([found], "12 episodes in each setting", 0, False)
    assert [column.heading for column in table.columns][:4] == ["task", "classical", "learned", "hybrid"]
    assert "best hybrid" not in suite_headline([found])[0]
    ahead = replace(found, hybrid_pairs={"classical": found.hybrid_pairs["classical"]})
    assert suite_headline([ahead])[0].endswith("the best hybrid is better than the best of the other kinds in ArmReach")


def task_steps(swept, first, second):
    steps = swept.comparisons[UNDISTURBED].episodes.pivot(index="episode", columns="policy", values="length")
    return (steps[first] - steps[second]).mean()


@pytest.mark.parametrize(("kind", "missing"), [("classical", "learned"), ("learned", "classical")])
def test_a_task_without_one_of_the_kinds_says_which(kind, missing):
    played = [summary_of("reach_ik", np.ones(10, dtype=bool))]
    cells = {UNDISTURBED: pd.DataFrame({"reach_ik": np.ones(10)})}
    choice: dict[str, Any] = {kind: Choice("reach_ik")}
    one = TaskVerdict("armctl/Some-v0", played, cells, {}, **choice)
    assert (one.verdict, one.context) == (f"no {missing} policy has played", "")
    assert one.rate(Choice("reach_ik")).value == 1
    assert TaskVerdict("armctl/Some-v0", [], {}, {}).verdict == "no episode was finished undisturbed"
    assert TaskVerdict("armctl/Some-v0", played, {}, {}).verdict == "the environment does not say what a success is"


def test_a_verdict_without_pairs_says_so():
    apart = TaskPair(50, 0, 0, 1e-4, wins=(50, 35), sample_sizes=(50, 60))
    (found,) = holm_corrected([answer_of(apart)])
    assert found.undisturbed.better == 1
    assert found.verdict.startswith("Classical is better")
    assert found.verdict.endswith("; on different episodes")
    assert success_test([found]) == "Barnard's exact test, on different episodes"
    both = [found, answer_of(head(3, 3))]
    assert (
        success_test(both)
        == "McNemar's exact test, on the same episodes, or Barnard's exact test, on different episodes"
    )
    assert success_test(both) in task_table(both, "50 episodes in each setting", 0, quick=True).caption
    assert success_test(both[1:]) == "McNemar's exact test, on the same episodes"

"""What the suite says of each task, and of all of them."""

from dataclasses import replace

import numpy as np
import pytest

from armctl.evaluation.across_tasks import HeadToHead
from armctl.evaluation.answers import Answer, corrected
from armctl.evaluation.paired import holm, mcnemar
from armctl.evaluation.sweep import UNDISTURBED
from armctl.report.suite_page import headline

from .test_verdict import summary_of

SETTINGS = ("delay 1", "noise 0.1")


def head(only_classical, only_learned, episodes=50, p=None):
    p = mcnemar(only_classical, only_learned) if p is None else p
    return HeadToHead(episodes, only_classical, only_learned, p)


def answer_of(undisturbed, *disturbed, env="armctl/Some-v0", timing=((1, 1), (1, 1))):
    policies = [
        replace(summary_of(name, np.ones(1, dtype=bool)), worlds=worlds, workers=workers)
        for name, (worlds, workers) in zip(("reach_ik", "reach_ppo"), timing, strict=True)
    ]
    heads = {UNDISTURBED: undisturbed, **dict(zip(SETTINGS, disturbed, strict=False))}
    return Answer(env, policies, {}, {name: name for name in heads}, ("reach_ik",) * 2, ("reach_ppo",) * 2, heads)


@pytest.mark.parametrize("sign", [1, -1])
def test_few_episodes_give_no_verdict_anywhere(sign):
    eight = head(*(8, 0)[::sign], episodes=8)
    assert eight.p < 0.05
    (one,) = corrected([answer_of(eight, head(*(0, 8)[::sign], episodes=8))])
    assert one.verdict.startswith("No verdict from 8 episodes")
    assert one.turns == ""
    assert headline([one]) == "Of 1 task, classical is better in 0, learned in 0, neither is shown to be in 1"


def test_verdicts_and_headline_are_corrected_for_all_tasks_and_agree():
    heads = [head(7, 0), head(0, 12), head(8, 1), head(3, 3)]
    answers = [answer_of(one, head(0, 20), env=f"armctl/Task{i}-v0") for i, one in enumerate(heads)]
    found = corrected([*answers, Answer("armctl/None-v0", [], {}, {})])
    assert [one.undisturbed.p for one in found[:-1]] == holm([one.p for one in heads])
    assert [one.undisturbed.better for one in answers] == [1, -1, 1, 0]
    assert [one.verdict.partition(":")[0] for one in found[:-1]] == [
        "Undecided" if one.undisturbed.better == 0 else ("Classical is better", "Learned is better")[i == 1]
        for i, one in enumerate(found[:-1])
    ]
    counts = [sum(one.undisturbed.better == sign for one in found[:-1]) for sign in (1, -1, 0)]
    assert counts[0] < 2
    assert headline(found) == (
        f"Of 4 tasks, classical is better in {counts[0]}, learned in {counts[1]}, neither is shown to be in {counts[2]}"
    )
    assert found[0].heads[SETTINGS[0]] == answers[0].heads[SETTINGS[0]]


def test_settings_are_counted_as_settings():
    assert answer_of(head(20, 0), head(20, 0), head(20, 0)).turns == "the order stays in all 2 disturbed settings"
    assert answer_of(head(3, 3), head(3, 3)).turns == "undecided in the disturbed setting"


@pytest.mark.parametrize(
    ("timing", "said"),
    [
        (((1, 1), (1, 1)), "reach_ik 0.25 ms, reach_ppo 0.25 ms."),
        (((4, 1), (4, 1)), "reach_ik 0.25 ms, reach_ppo 0.25 ms (shares of a batch of 4 worlds)."),
        (((1, 1), (4, 1)), "reach_ik 0.25 ms (latency), reach_ppo 0.25 ms (shares of a batch of 4 worlds)."),
        (
            ((2, 1), (4, 1)),
            "reach_ik 0.25 ms (shares of a batch of 2 worlds), reach_ppo 0.25 ms (shares of a batch of 4",
        ),
    ],
)
def test_what_decision_times_are_is_said_of_whom_it_is_true(timing, said):
    assert said in answer_of(head(3, 3), timing=timing).costs

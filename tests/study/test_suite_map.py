"""Which kind leads in a task and setting, from the pairs of the verdict."""

from dataclasses import replace

import pytest

from armctl.episodes.stored import UNDISTURBED
from armctl.stats.across_tasks import Choice, TaskPair
from armctl.stats.paired import mcnemar
from armctl.study.suite_map import kind_lead, lead_table, map_columns, setting_in_column
from armctl.study.task_verdict import TaskVerdict

REACH = "armctl/ArmReach-v0"
LEVELS = {"delay": [0.0, 2.0, 8.0], "noise": [0.0, 0.05]}


def pair(only_classical, only_learned, episodes=200):
    return TaskPair(episodes, only_classical, only_learned, mcnemar(only_classical, only_learned))


def verdict(**pairs):
    by_setting = {name.replace("_", "-"): pair for name, pair in pairs.items()}
    choices = Choice("reach_ik"), Choice("reach_ppo")
    return TaskVerdict(REACH, [], {}, {}, *choices, {UNDISTURBED: pair(0, 0)} | by_setting)


@pytest.mark.parametrize(
    ("counts", "text", "certain"),
    [
        ((40, 2), "C +19", True),
        ((2, 40), "L +19", True),
        ((4, 2), "C +1 ?", False),
        ((0, 0), "=", False),
        ((3, 3), "=", False),
    ],
)
def test_the_kind_with_the_higher_success_leads(counts, text, certain):
    lead = kind_lead(verdict(none=pair(*counts)), "none")
    assert (lead.text, lead.certain) == (text, certain)
    assert lead.policies == {"classical": "reach_ik", "learned": "reach_ppo"}


def against(kind, *counts):
    return {kind: {UNDISTURBED: pair(*counts)}}


def test_a_hybrid_leads_if_it_is_ahead_of_both_and_certainly_only_if_it_is_better_than_both():
    both = replace(
        verdict(), hybrid=Choice("mix"), hybrid_pairs=against("classical", 40, 2) | against("learned", 60, 2)
    )
    lead = kind_lead(both, UNDISTURBED)
    assert (lead.text, lead.policies["hybrid"]) == ("H +19", "mix")
    one = replace(both, hybrid_pairs=against("classical", 4, 2) | against("learned", 60, 2))
    assert kind_lead(one, UNDISTURBED).text == "H +1 ?"
    behind = replace(
        verdict(none=pair(40, 2)),
        hybrid=Choice("mix"),
        hybrid_pairs=against("classical", 2, 40) | against("learned", 60, 2),
    )
    assert kind_lead(behind, UNDISTURBED).kind == "classical"


def test_a_small_lead_of_many_episodes_is_equivalent():
    assert kind_lead(verdict(none=pair(3, 1, 2000)), "none").text == "C +0 ~"


def test_too_few_episodes_make_no_lead_certain():
    assert not kind_lead(verdict(none=pair(9, 0, 9)), "none").certain


def test_a_setting_without_a_pair_is_not_compared():
    assert kind_lead(verdict(), "delay-8.0") is None


def test_columns_are_levels_by_number_whatever_each_task_calls_them():
    other = {"delay": [0.0, 5.0], "payload": [0.0, 5.0]}
    columns = map_columns([LEVELS, other])
    assert columns == [("delay", 1), ("delay", 2), ("noise", 1), ("payload", 1)]
    assert [setting_in_column(other, column) for column in columns] == [
        ("delay-5.0", 5.0), None, None, ("payload-5.0", 5.0)
    ]  # fmt: skip


def test_the_table_has_a_row_for_each_task_and_marks_what_is_not_certain():
    task = verdict(**{"delay_8.0": pair(60, 1), "noise_0.05": pair(1, 3)})
    table = lead_table([task], {REACH: LEVELS})
    assert [column.heading for column in table.columns] == ["task", "none", "delay (1)", "delay (2)", "noise (1)"]
    assert [cell.text for cell in table.rows[0]] == [REACH, "=", "-", "C +30", "L +1 ?"]
    assert [record["certain"] for record in table.records] == [False, True, False]

"""Pairs that somebody or some file may have chosen are told beside the verdict, or are not compared as pairs."""

import pytest

from .written import judged

COLUMNS = "policy,episode,success"


def rows(policy, wins, episodes):
    return [f"{policy},{k},{int(k in wins)}" for k in episodes]


def remarks(judgement):
    parts = judgement.document().parts
    verdicts = [i for i, part in enumerate(parts) if getattr(part, "kind", "") == "verdict"]
    return getattr(parts[verdicts[-1] + 1], "text", "")


def alternating(n, every=3):
    return {k for k in range(n) if k % every}


def test_fewer_than_half_of_the_episodes_are_no_pairs(tmp_path):
    """A new policy that was tried on the failures of the old one only."""
    old = rows("old", set(range(0, 100, 7)) ^ set(range(100)), range(100))
    judgement = judged(tmp_path, [COLUMNS, *old, *rows("new", {0, 7, 14, 21, 28}, range(0, 100, 7))])
    assert not judgement.overall.facts.paired
    assert [policy.episodes for policy in judgement.overall.policies] in ([100, 15], [15, 100])
    assert "all policies have only 15 episodes, and one has 100" in remarks(judgement)


@pytest.mark.parametrize(
    ("wins", "kept", "is_doubtful"),
    [
        (alternating(100), 97, False),
        (alternating(100), 80, True),  # more than a tenth
        ({k for k in range(94) if k % 5}, 94, True),  # few, and all of them failures
    ],
)
def test_what_is_left_out_is_told(tmp_path, wins, kept, is_doubtful):
    judgement = judged(
        tmp_path, [COLUMNS, *rows("old", wins, range(100)), *rows("new", alternating(kept), range(kept))]
    )
    assert judgement.overall.facts.paired
    left_out, won = 100 - kept, len(wins - set(range(kept)))
    both = f"{left_out} of old ({won} of them and {len(wins) - won} of the {kept} kept are successes)"
    assert any(both in note for note in judgement.overall.notes)
    assert ("may have been chosen by their outcome" in remarks(judgement)) == is_doubtful


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("wins", "is_told"),
    [
        (set(range(30, 50)), True),
        (set(range(5)), True),
        ({0}, True),
        (alternating(50), False),
        (set(range(50)), False),
    ],
)
def test_episodes_that_were_sorted_by_success_are_told(tmp_path, wins, is_told):
    lines = [COLUMNS, *rows("old", wins, range(50)), *rows("new", alternating(50), range(50))]
    assert ("Sorted by success" in remarks(judged(tmp_path, lines))) == is_told
    assert "Sorted by success" not in remarks(judged(tmp_path, lines, unpaired=True))


def test_doubts_of_a_task_stand_beside_the_verdict_on_all(tmp_path):
    lines = ["task,policy,episode,success"]
    for task, n in (("a", 40), ("b", 50)):
        lines += [f"{task},{row}" for row in rows("old", alternating(50), range(n))]
        lines += [f"{task},{row}" for row in rows("new", alternating(50), range(40))]
    assert "b: The pairs may have been chosen" in remarks(judged(tmp_path, lines))

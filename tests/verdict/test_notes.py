"""Remarks about a comparison's episodes."""

from dataclasses import replace

import pytest

import armctl
from armctl.envs import ERROR
from armctl.episodes.table import EpisodeTable
from armctl.verdict.notes import STUCK_PATH, certificate_notes, first_step_notes, motion_notes, unclean_notes
from armctl.verdict.scores import WITHIN_RANGE, WITHIN_SPEED, clean

from ..made_up_episodes import played


def test_infeasible_episodes_that_were_won_are_reported():
    lost, won = ([replace(one, success=success) for one in played(10, ("a", "b"))] for success in (False, True))
    assert certificate_notes(EpisodeTable(lost)) == []
    (note,) = certificate_notes(EpisodeTable(one for one in won if one.feasible or one.policy == "a"))
    assert note == "2 episodes labelled infeasible were won (2 by a): the certificate is too strict."


def test_a_comparison_without_a_feasible_episode_says_so():
    options = {"target": "box", "target_box": ((3, 3, 3), (4, 4, 4)), "max_episode_steps": 3}
    comparison = armctl.compare(["reach_ik", "random"], episodes=4, env_options=options)
    assert not comparison.policies
    assert any(note.startswith("All 4 episodes are labelled infeasible") for note in comparison.notes)


def test_starts_that_are_successes_are_told():
    """The target of an episode is within a tolerance of 0.9 m from the start, or it is not."""
    comparison = armctl.compare(["reach_ik", "random"], episodes=6, env_options={"tolerance": 0.9})
    (note,) = (note for note in comparison.notes if "first control step" in note)
    count = sum((results.length == 1).all() for _, results in comparison.episodes.groupby("episode"))
    assert 0 < count < 6
    assert note.startswith(f"{count} of 6 episodes ")


@pytest.mark.parametrize(
    ("changes", "reported"),
    [
        ({}, True),
        ({"length": 2}, False),
        ({"success": False}, False),
        ({"success": None}, False),
    ],
)
def test_a_first_step_that_not_every_policy_wins_is_not_told(changes, reported):
    """The last of three policies differs."""
    won = [replace(one, success=True, length=1) for one in played(4, ("a", "b", "c"))]
    tables = EpisodeTable(replace(one, **changes) if one.policy == "c" else one for one in won).by_policy()
    notes = first_step_notes(tables)
    assert [note.startswith("4 of 4 episodes are won by every policy") for note in notes] == [True] * reported
    assert first_step_notes({}) == []


@pytest.mark.parametrize(
    ("change", "period", "reported"),
    [
        ({}, 0.05, True),
        ({}, None, False),
        ({}, 0.02, False),  # an episode of 0.6 s
        ({"success": True}, 0.05, False),
        ({"outcome": ERROR}, 0.05, False),
        ({"path": 2 * STUCK_PATH}, 0.05, False),
    ],
)
def test_a_policy_that_hardly_moves_is_reported(change, period, reported):
    path = change.pop("path", STUCK_PATH / 2)
    episodes = [
        replace(one, length=30, **{"success": False} | change, metrics=replace(one.metrics, path_length=path))
        for one in played(4)
    ]
    notes = motion_notes(EpisodeTable(episodes), period)
    assert [note.startswith("a hardly moved in 4 of 4 episodes") for note in notes] == [True] * reported


@pytest.mark.parametrize(
    ("use", "torque_control", "reason"),
    [
        ({}, False, None),
        ({"range_use": WITHIN_RANGE, "speed_use": WITHIN_SPEED}, False, None),
        ({"contacts": None}, False, None),
        ({"contacts": 2}, False, "4 with a forbidden contact"),
        ({"range_use": 1.02}, False, "4 beyond 1.01 times half a joint's range (up to 1.02)"),
        ({"speed_use": 1.31}, False, "4 beyond 1.2 times a speed limit (up to 1.31, which the drives do not command)"),
        ({"speed_use": 1.31}, True, "4 beyond 1.2 times a speed limit (up to 1.31)"),
        ({"contacts": 2, "speed_use": 1.31}, True, "4 with a forbidden contact, 4 beyond 1.2 times"),
    ],
)
def test_a_success_that_is_not_clean_has_its_reason(use, torque_control, reason):
    limits = {"contacts": 0, "range_use": 0.5, "speed_use": 0.5} | use
    episodes = [replace(one, success=True, metrics=replace(one.metrics, **limits)) for one in played(4, ("a",))]
    notes = unclean_notes({"a": EpisodeTable(episodes)}, torque_control)
    assert [note.startswith(f"4 of 4 successes of a are not clean: {reason}") for note in notes] == (
        [] if reason is None else [True]
    )
    if use.get("contacts", 0) is not None:
        assert clean(EpisodeTable(episodes)).all() == (reason is None)
    lost = [replace(one, success=False) for one in episodes]
    assert unclean_notes({"a": EpisodeTable(lost)}, torque_control) == []

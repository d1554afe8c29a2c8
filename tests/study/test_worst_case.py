"""Worst cases: what is searched, judged, kept and refused."""

import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import armctl
from armctl.core.errors import ConfigurationError, ResultsError
from armctl.core.seeds import TEST_SEED
from armctl.envs import make_worlds
from armctl.report import write_report
from armctl.report.worst_case_page import headline
from armctl.stats.intervals import Estimate
from armctl.study import worst_case
from armctl.study.axis import Axis
from armctl.study.levels import disturbance_specs
from armctl.study.mildest_failure import read_worst_cases
from armctl.study.results import read_comparison, read_study
from armctl.study.search_box import levels_at, levels_between, point_at, points_of, search_axes

from ..report.pages import text_of

REACH = "armctl/ArmReach-v0"
DELAY = Axis("delay", 0.0, 8.0, True, "control steps")
STRENGTH = Axis("strength", 1.0, 0.2, False, "left")
SHORT = {"max_episode_steps": 40}
BOX = ["payload", "friction"]
"""Levels on which these policies agree whatever they observe."""


def run(**arguments):
    options: dict[str, Any] = {
        "policies": ["reach_ik", "random"],
        "disturbances": BOX,
        "budget": 50,
        "episodes": 12,
        "worlds": 10,
    }
    options |= {"env_options": SHORT} | arguments
    return worst_case(options.pop("policies"), **options)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("worst")
    return run(out=folder), folder


def test_levels_and_points_belong_together():
    axes, point = [DELAY, STRENGTH], np.array([0.5, 0.25])
    assert levels_at(axes, point) == {"delay": 4.0, "strength": 0.8}
    np.testing.assert_allclose(point_at(axes, levels_at(axes, point)), point)
    assert levels_at(axes, np.zeros(2)) == {}
    ranges = levels_between(axes, np.array([0.3, 0.5]), np.array([0.45, 1.0]))
    assert ranges == {"delay": (2.0, 4.0), "strength": (0.2, 0.6)}


def test_points_of_episodes_are_the_levels_that_the_environment_draws():
    disturbances = {"delay": (0.0, 8.0), "payload": (0.0, 20.0)}
    axes = [DELAY, Axis("payload", 0.0, 20.0, False, "kg")]
    worlds = make_worlds(REACH, 3, {"disturbances": disturbances})
    worlds.reset(seed=[7, 7, 7], options={"episode": [2, 5, 9]})
    levels = [worlds.disturbances[name].levels for name in ("delay", "payload")]
    expected = np.stack(levels, axis=1) / [8.0, 20.0]
    np.testing.assert_allclose(points_of(axes, disturbances, 7, [2, 5, 9]), expected)
    worlds.close()


def test_a_range_ends_at_the_strongest_default_level_or_where_it_is_told_to():
    specs = disturbance_specs(REACH, {})
    assert [(axis.name, axis.end) for axis in search_axes(specs, {"strength": None, "delay": [4]})] == [
        ("strength", 0.2),
        ("delay", 4.0),
    ]
    assert [axis.name for axis in search_axes(specs, None)] == ["delay", "noise", "payload", "friction", "mismatch"]


@pytest.mark.slow
def test_a_policy_that_always_fails_does_so_undisturbed_and_a_better_one_further_away(finished):
    result, _ = finished
    assert [case.policy for case in result.cases] == ["reach_ik", "random"]
    best, worst = result.cases
    assert (worst.levels, worst.distance) == ({}, Estimate(0.0, 0.0, 0.0))
    assert worst.summary.success.value == 0
    assert best.distance.value > 0.3
    assert best.distance.low <= best.distance.value <= best.distance.high
    assert {"payload", "friction"} >= set(best.levels)
    assert [point.distance for point in best.line] == sorted({point.distance for point in best.line})
    assert best.searched == worst.searched == 50


@pytest.mark.slow
def test_searched_and_judged_episodes_are_of_different_seeds(finished):
    result, folder = finished
    seeds = [read_study(folder / f"search-{number}").seed for number in range(1, 6)]
    assert seeds == [0, 1, 2, 3, 4]
    assert read_study(folder).seed == result.judge_seed == 5


@pytest.mark.slow
def test_it_is_read_back_and_asked_again_nothing_is_played(finished):
    result, folder = finished
    again = read_worst_cases(folder)
    assert again.records == result.records
    assert pd.read_csv(folder / "worst_case.csv").policy.tolist() == ["reach_ik", "random"]
    before = (folder / "episodes.csv").read_text()
    assert run(out=folder).records == result.records
    assert (folder / "episodes.csv").read_text() == before


@pytest.mark.slow
def test_the_page_says_what_the_table_says_and_has_the_command(finished):
    result, folder = finished
    text = text_of(write_report(folder, video=False))
    assert headline(result) in text
    assert result.cases[0].replay in text
    assert "armctl worst-case reach_ik random" in text
    box = "--set max_episode_steps=40 --disturbances payload=20,friction=0.8"
    assert f"{box} --budget 50 --episodes 12 --seed 0 --judge-seed 5" in text


@pytest.mark.slow
def test_the_failure_that_is_shown_is_one(finished):
    result, _ = finished
    case = result.cases[0]
    assert f"--episode {case.failure.episode} " in case.replay
    levels = re.search(r"disturbances=(\{.*?\})", case.replay)[1]
    replayed = armctl.compare(
        ["reach_ik"], episodes=case.failure.episode + 1, seed=5, env_options=SHORT | {"disturbances": eval(levels)}
    )
    assert not replayed.episodes.success.iloc[-1]


@pytest.mark.slow
def test_an_interrupt_keeps_what_was_played(tmp_path):
    count = 0

    def interrupt(part, result):
        nonlocal count
        count += 1
        if count == 30:
            raise KeyboardInterrupt

    first = run(policies=["random"], out=tmp_path, progress=interrupt)
    assert first.interrupted
    assert not first.cases
    whole = run(policies=["random"], out=tmp_path)
    assert not whole.interrupted
    assert [case.searched for case in whole.cases] == [50]
    assert whole.records == run(policies=["random"]).records


@pytest.mark.slow
def test_disturbances_that_spare_a_policy_are_not_searched():
    result = run(policies=["random"], disturbances=["noise", "payload"])
    (case,) = result.cases
    assert case.spared == ("noise",)
    assert "not affected by noise" in " ".join(part.text for part in result.document().parts if hasattr(part, "text"))


@pytest.mark.slow
def test_a_comparison_is_asked_for_where_worst_cases_are(finished):
    _, folder = finished
    with pytest.raises(ResultsError, match="holds a worst case, not a comparison"):
        read_comparison(folder)


@pytest.mark.slow
def test_a_round_of_another_search_is_refused(finished, tmp_path):
    _, folder = finished
    copy = shutil.copytree(folder, tmp_path / "copy")
    shutil.rmtree(copy / "search-3")
    run(policies=["random"], disturbances=["delay"], out=tmp_path / "other")
    shutil.copytree(tmp_path / "other" / "search-3", copy / "search-3")
    with pytest.raises(ResultsError, match="rounds of another one"):
        read_worst_cases(copy)
    with pytest.raises(ResultsError, match="holds no results"):
        read_worst_cases(folder / "search-1")


def test_a_range_without_levels_is_impossible():
    assert not replace(DELAY, end=0.0).is_possible
    assert not replace(DELAY, end=1e9).is_possible
    assert not replace(DELAY, end=0.5).is_possible
    assert DELAY.is_possible
    assert STRENGTH.is_possible


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        ({"budget": 49}, "at least 50"),
        ({"seed": TEST_SEED - 2}, "sealed test is not for a search"),
        ({"seed": "test"}, "sealed test is not for a search"),
        ({"judge_seed": 3}, "seeds 0 to 4 are for the search"),
        ({"disturbances": ["nois"]}, "noise"),
        ({"disturbances": {"noise": [0.1, 0.2]}}, "the end of its range"),
        ({"disturbances": ["slow-down"]}, "sweep it"),
        ({"disturbances": []}, "1 to 6"),
        ({"until": "decided"}, "until"),
        ({"policies": ["reach_bc[*]"]}, "single training"),
    ],
)
def test_other_requests_are_refused(arguments, why, tmp_path):
    with pytest.raises(ConfigurationError, match=re.escape(why)):
        run(out=tmp_path / "new", **arguments)
    assert not Path(tmp_path / "new").exists()

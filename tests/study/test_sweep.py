import io
import os
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

import armctl
from armctl.core.errors import ConfigurationError, ResultsError
from armctl.episodes.table import EpisodeTable
from armctl.report import write_report
from armctl.report.terminal import tables
from armctl.stats.paired import mcnemar
from armctl.stats.robustness import NEUTRAL, Onset, degradations
from armctl.study import compare, sweep
from armctl.study.levels import sweep_levels
from armctl.study.results import read_study
from armctl.study.task_results import COLUMNS
from armctl.verdict.summary_tables import sweep_parts
from tests.report.pages import plot_of

from ..stores import timeless

POLICIES = ["reach_ik", "random"]
LEVELS = {"noise": [0.05], "delay": [2, 0, 2]}
REACH = "armctl/ArmReach-v0"


def run(**arguments):
    options: dict[str, Any] = {"disturbances": LEVELS, "episodes": 4, "seed": 3} | arguments
    return sweep(options.pop("policies", POLICIES), **options)


def printed(found):
    console = Console(file=(out := io.StringIO()), width=100)
    console.print(tables(found))
    return out.getvalue()


def by_cell(folder):
    rows = timeless(folder)
    return {name: its.drop(columns="cell").reset_index(drop=True) for name, its in rows.groupby("cell", sort=False)}


def same(one, other):
    return one.keys() == other.keys() and all(one[name].equals(other[name]) for name in one)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep")
    return run(out=folder), folder


@pytest.mark.slow
def test_the_points_are_those_of_the_comparisons(finished):
    found, folder = finished
    points = pd.read_csv(folder / "sweep.csv")
    assert tuple(points.columns) == COLUMNS
    assert list(zip(points.disturbance, points.level, points.policy, strict=True)) == [
        (name, level, policy)
        for name, levels in (("noise", (0, 0.05)), ("delay", (0, 2)))
        for level in levels
        for policy in POLICIES
    ]
    pd.testing.assert_frame_equal(points, found.points, check_dtype=False)
    for name, disturbances in (("none", {}), ("noise-0.05", {"noise": 0.05}), ("delay-2.0", {"delay": 2.0})):
        options = {"disturbances": disturbances} if disturbances else {}
        alone = compare(POLICIES, episodes=4, seed=3, env_options=options)
        pd.testing.assert_frame_equal(timeless(alone.episodes), by_cell(folder)[name])
        for policy in alone.policies:
            level = next(iter(disturbances.values()), 0.0)
            rows = points[(points.policy == policy.policy) & (points.level == level)]
            rows = rows[rows.disturbance == next(iter(disturbances), "delay")]
            assert rows.success.tolist() == [policy.success.value]
            assert rows.low.tolist() == [policy.success.low]
            np.testing.assert_allclose(rows["return"], policy.episode_return.value)
    undisturbed = points[points.level == 0].drop(columns=["disturbance", "unit"])
    assert undisturbed[:2].reset_index(drop=True).equals(undisturbed[2:].reset_index(drop=True))


def test_the_pairs_of_a_sweep_are_kept(finished):
    found, folder = finished
    both = frozenset(POLICIES)
    pairs = {
        name: one.differences[0]
        for name, one in found.comparisons.items()
        if name != "noise-0.05"  # which spares random: it reads no observation
    }
    assert found.pairs == {
        (*NEUTRAL, both): pairs["none"],
        ("delay", 2.0, both): pairs["delay-2.0"],
    }
    (again,) = read_study(folder).tasks.values()
    assert again.pairs == found.pairs
    pd.testing.assert_frame_equal(again.points, found.points)


def test_a_spared_policy_is_told_so_and_in_no_test(finished):
    found, folder = finished
    spared = found.points[found.points.spared]
    assert list(zip(spared.disturbance, spared.level, spared.policy, strict=True)) == [("noise", 0.05, "random")]
    assert spared[["p", "change"]].isna().all(axis=None)
    noise = next(table for table in found.document().tables if table.title.startswith("noise"))
    assert [[cell.text for cell in row] for row in noise.rows][1][2] == "spared"
    assert "Not affected, so not ranked: random." in " ".join(printed(found).split())
    lines = [one for one in plot_of(write_report(folder, video=False), "level of noise")["data"] if one.get("name")]
    assert [(line["name"], line["line"]["dash"]) for line in lines] == [
        ("reach_ik", "solid"),
        ("random (spared)", "dot"),
    ]


def test_p_is_mcnemars_on_the_same_episodes():
    found = run(policies=["reach_ik"], disturbances={"payload": [20]}, episodes=12, worlds=6)
    before, after = (found.comparisons[name].episodes.set_index("episode").success for name in ("none", "payload-20.0"))
    expected = mcnemar(int((before & ~after).sum()), int((~before & after).sum()))
    assert found.points.p.tolist() == [1.0, expected]
    assert expected < 1


@pytest.mark.slow
def test_asked_again_nothing_is_played_and_more_is_added(finished, tmp_path):
    _, folder = finished
    before = (folder / "episodes.csv").read_text()
    told = []
    run(out=folder, progress=lambda setting, result: told.append(setting))
    assert (folder / "episodes.csv").read_text() == before  # times included
    assert told == ["none"] * 8 + ["noise-0.05"] * 8 + ["delay-2.0"] * 8
    more = run(out=folder, disturbances=LEVELS | {"noise": [0.05, 0.1]})
    assert more.points.level.unique().tolist() == [0, 0.05, 0.1, 2]
    rows = (folder / "episodes.csv").read_text().splitlines()
    assert set(before.splitlines()) < set(rows)


def test_fewer_levels_than_there_are_would_be_forgotten(finished):
    _, folder = finished
    with pytest.raises(ResultsError, match=r"further results \(delay-2\.0.*\): ask for these too"):
        run(out=folder, disturbances={"noise": [0.05]})


@pytest.mark.slow
def test_a_comparison_is_extended_to_a_sweep(tmp_path):
    alone = compare(POLICIES, episodes=4, seed=3, out=tmp_path)
    found = run(out=tmp_path, disturbances={"noise": [0.05]})
    assert found.undisturbed.resumed == len(alone.episodes) == 8
    assert [one.success for one in found.undisturbed.policies] == [one.success for one in alone.policies]
    with pytest.raises(ResultsError, match="further results"):
        compare(POLICIES, episodes=4, seed=3, out=tmp_path)


def test_another_seed_is_refused_and_nothing_lost(finished):
    _, folder = finished
    before = by_cell(folder)
    with pytest.raises(ResultsError, match="seed: 3 there, 4 here"):
        run(out=folder, seed=4)
    assert same(by_cell(folder), before)


@pytest.mark.slow
def test_worlds_and_workers_change_nothing(tmp_path):
    run(out=tmp_path / "one")
    run(out=tmp_path / "other", worlds=2, workers=2)
    assert same(by_cell(tmp_path / "one"), by_cell(tmp_path / "other"))
    one, other = (pd.read_csv(tmp_path / name / "sweep.csv") for name in ("one", "other"))
    assert one.equals(other)


class Interrupting:
    """Stops after so many decisions as a variable of the process says, which is no part of what it is."""

    sees, training_steps = "model", 0

    def __init__(self, env):
        self.policy = armctl.make_policy("reach_ik", env)

    def reset(self, ids):
        self.policy.reset(ids)

    def act(self, observations):
        os.environ["DECISIONS_LEFT"] = str(int(os.environ["DECISIONS_LEFT"]) - 1)
        if os.environ["DECISIONS_LEFT"] == "0":
            raise KeyboardInterrupt
        return self.policy.act(observations)


@pytest.mark.slow
@pytest.mark.parametrize("decisions", [5, 80])
def test_an_interrupted_sweep_keeps_its_episodes_and_goes_on(decisions, tmp_path, monkeypatch):
    monkeypatch.setenv("DECISIONS_LEFT", str(decisions))
    cut = run(policies=[Interrupting], out=tmp_path / "cut")
    assert cut.interrupted
    assert "Interrupted." in printed(cut)
    assert read_study(tmp_path / "cut").interrupted
    kept = sum(map(len, by_cell(tmp_path / "cut").values()))
    assert 0 <= kept < 12
    again = run(policies=[Interrupting], out=tmp_path / "cut")
    assert not again.interrupted
    assert sum(one.resumed for one in again.comparisons.values()) == kept
    run(policies=[Interrupting], out=tmp_path / "whole")
    assert same(by_cell(tmp_path / "cut"), by_cell(tmp_path / "whole"))
    assert (tmp_path / "cut" / "sweep.csv").read_text() == (tmp_path / "whole" / "sweep.csv").read_text()


@armctl.sees("state")
def interrupted_while_made(env):
    raise KeyboardInterrupt


def test_an_interrupt_before_the_first_episode(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        compare(interrupted_while_made, episodes=2, out=tmp_path / "compared")
    found = run(policies=[interrupted_while_made], out=tmp_path / "swept")
    assert found.interrupted
    assert "Interrupted." in printed(found)
    assert not (tmp_path / "compared").exists()
    assert not (tmp_path / "swept").exists()


@armctl.sees("state")
def failing_when_late(env):
    policy = armctl.make_policy("reach_ik", env)
    if "delay" in env.disturbances:
        policy.act = lambda observations: np.full((len(observations), 6), np.nan)
    return policy


def test_a_policy_that_fails_at_one_level_spoils_no_other():
    found = run(policies=[failing_when_late, "reach_ik"])
    assert list(found.failures) == ["delay-2.0: failing_when_late"]
    assert "is not finite" in printed(found)
    counts = found.points.groupby("policy").size()
    assert (counts["reach_ik"], counts["failing_when_late"]) == (4, 3)


def test_options_of_the_environment_hold_at_every_level():
    options = {"disturbances": {"strength": 0.1}, "max_episode_steps": 7}
    found = run(policies=["reach_ik"], env_options=options, disturbances=["noise"])
    assert all(one.episodes.length.max() <= 7 for one in found.comparisons.values())
    assert found.comparisons["none"].env_options["disturbances"] == {"strength": 0.1}
    assert found.comparisons["noise-0.02"].env_options["disturbances"] == {"strength": 0.1, "noise": 0.02}
    assert options["disturbances"] == {"strength": 0.1}


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        (["noises"], "Did you mean 'noise'"),
        (["dropout"], "no disturbance to sweep here 'dropout'"),
        ({"payload": [-1]}, "payload is a number from 0"),
        ({"payload": ["a"]}, "not 'a'"),
        ({"payload": "1,2"}, "are numbers, such as"),
        ({"payload": 3}, "are numbers, such as"),
        ({"payload": []}, "needs a level besides 0"),
        ({"strength": [1]}, "needs a level besides 1"),
    ],
)
def test_unusable_levels_say_what_is_allowed(asked, says, tmp_path):
    with pytest.raises(ConfigurationError, match=says):
        sweep(["random"], disturbances=asked, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_disturbance_that_lasts_is_none_to_sweep():
    with pytest.raises(ConfigurationError, match="to sweep here 'noise'"):
        sweep_levels(REACH, ["noise"], {"disturbances": {"noise": 0.1}})


def test_without_any_asked_for_there_are_all_with_their_own_levels():
    assert sweep_levels(REACH)["strength"] == [1, 0.8, 0.6, 0.4, 0.2]
    assert "dropout" in sweep_levels("armctl/BridgeCross-v0")
    assert "dropout" not in sweep_levels("armctl/BridgeCross-v0", env_options={"observation": "state"})
    assert sweep_levels(REACH, {"strength": [0.5, 0.9], "noise": None})["strength"] == [1, 0.9, 0.5]


def points(**successes):
    rows = [
        {"disturbance": "noise", "level": level, "policy": policy, "success": success, "p": p, "unit": "m",
         "sees": "observation", "low": success - 0.1, "high": success + 0.1, "change": success - curve[0][0],
         "spared": False}
        for policy, curve in successes.items()
        for level, (success, p) in enumerate(curve)
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_what_is_said_of_a_curve_minds_chance():
    frame = points(
        steady=[(1.0, 1.0), (0.96, 0.5), (0.9, 0.06)],
        failing=[(1.0, 1.0), (0.7, 1e-5), (0.4, 1e-9)],
        better=[(0.4, 1.0), (0.9, 1e-6), (1.0, 1e-9)],
    )
    found = {one.policy: (one.drops, one.below_half) for one in degradations(frame)}
    assert found == {
        "steady": (None, None),
        "failing": (Onset(1.0), Onset(2.0)),
        "better": (None, Onset(0.0, lasts=False)),
    }
    unlucky = points(**{f"p{i}": [(1.0, 1.0), (0.9, 0.5 if i else 0.04)] for i in range(20)})
    assert all(one.drops is None for one in degradations(unlucky))  # one of 20 is below 0.05 by chance


def test_the_tables_tell_levels_and_failures(finished):
    text = printed(finished[0])
    assert "noise, m, rad, m/s" in text
    assert "random: no significant drop, below half from 0 on." in text


def test_whoever_recovers_is_not_worse_from_there_on():
    frame = points(
        a=[(1.0, 1.0), (0.8, 1e-4), (0.99, 1.0), (1.0, 1.0)], b=[(0.9, 1.0), (0.4, 1e-9), (0.7, 1e-3), (0.6, 1e-4)]
    )
    text = "\n".join(getattr(part, "text", "") for part in sweep_parts(frame, {}))
    assert "a: worse at 1. b: worse from 1 on, below half at 1." in text
    assert "crossed" not in text
    group = frame.replace({"policy": {"b": "b[*]"}})
    assert "McNemar's exact test; [*]: over trainings and episodes" in sweep_parts(group, {})[-1].text


def test_only_what_counts_is_held_against_the_undisturbed():
    """An infeasible episode, and one that was finished after an unfinished one, are left out of p as of all figures."""
    found = run(policies=["reach_ik"], disturbances={"delay": [1]}, episodes=2)
    one = found.comparisons["none"].results[0]
    before = [replace(one, episode=k, success=True, feasible=True) for k in range(12)]
    labelled = [replace(one, success=False, feasible=one.episode < 4) for one in before]
    unfinished = [
        replace(one, success=False, episode=k) for one, k in zip(before, [*range(4), *range(5, 13)], strict=True)
    ]
    for spoilt in (labelled, unfinished):
        comparisons = {
            "none": replace(found.comparisons["none"], results=EpisodeTable(before)),
            "delay-1.0": replace(found.comparisons["none"], results=EpisodeTable(spoilt)),
        }
        only = replace(found, comparisons=comparisons)
        row = only.points.iloc[1]
        assert (row.p, row.change) == (mcnemar(4, 0), -1.0)


def test_the_ranking_is_the_verdict(finished):
    found, _ = finished
    *_, last = (part for part in found.document().parts if getattr(part, "kind", "") == "verdict")
    assert last.text == (
        "Under noise, no ranking: fewer than two policies are affected and tested; "
        "under delay, undecided: no significant difference between policies in 4 episodes."
    )
    assert last.text in " ".join(printed(found).split())

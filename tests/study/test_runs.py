import dataclasses
import json
import os
import subprocess
import sys
from typing import Any

import pandas as pd
import pytest

import armctl
from armctl.core.files import digest
from armctl.runtime import provenance
from armctl.runtime.provenance import MAX_BACKGROUND_LOAD, Run, RunMeter, earlier_looks, processor_model
from armctl.study import compare
from armctl.study.results import read_comparison

from ..stores import read_cell

SHORT = {"max_episode_steps": 3}
NOTE = "Deadlines are not judged"


def play(folder, episodes=2, **options):
    return compare(["random"], episodes=episodes, out=folder, env_options=SHORT, **options)


def test_every_row_carries_the_run_that_made_it_and_a_resumed_comparison_has_both(tmp_path):
    play(tmp_path)
    play(tmp_path, episodes=5, worlds=3)
    first, second = read_comparison(tmp_path).runs
    assert pd.read_csv(tmp_path / "episodes.csv").run.tolist() == 2 * [first.id] + 3 * [second.id]
    assert ((first.worlds, first.workers), (second.worlds, second.workers)) == ((1, 1), (3, 1))
    assert (first.load_start, first.load_most, first.load_end) == (0, 0, 0)
    assert first.versions["mujoco"]
    assert first.processor == processor_model() != ""
    assert json.loads((tmp_path / "summary.json").read_text())["runs"][0]["id"] == first.id


def test_an_id_is_the_content_of_its_record():
    run = RunMeter({"env": "a"}, 1, 1).run
    known = dataclasses.asdict(run)
    later = {
        name: known.pop(name)
        for name in ("id", "load_most", "load_end", "load_own", "judged", "baseline", "margin", "overwritten")
    }
    assert later["id"] == f"run-{digest([{'env': 'a'}, known])}"
    assert RunMeter({"env": "b"}, 1, 1).run.id != run.id


@pytest.mark.parametrize("checksum", ["1234567890123456", "12345678901234e5"])
def test_an_id_is_no_number_to_a_reader_of_the_table(checksum, tmp_path, monkeypatch):
    monkeypatch.setattr(provenance, "digest", lambda values: checksum)
    comparison = play(tmp_path)
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "episodes.csv"), comparison.episodes)


def test_threads_are_told(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    threads = RunMeter({}, 1, 1).run.threads
    assert threads["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in threads


@pytest.mark.slow
def test_a_run_that_was_killed_is_known_and_what_was_judged_before_it_too(tmp_path):
    both = {"policies": ["random", "reach_ik"], "out": tmp_path, "env_options": SHORT}
    compare(**both, episodes=10)
    code = f"""
import os, armctl
def end(result):
    if result.episode == 11:
        os._exit(1)
armctl.compare(["random", "reach_ik"], episodes=40, out={str(tmp_path)!r}, env_options={SHORT!r}, progress=end)
"""
    assert subprocess.run([sys.executable, "-c", code]).returncode == 1
    first, killed = read_cell(tmp_path).runs
    assert (first.judged, killed.judged, killed.load_end) == (10, None, None)
    resumed = compare(**both, episodes=40)
    assert resumed.looks == read_comparison(tmp_path).looks == [10]
    assert resumed.verdict.result.endswith("; p and intervals hold at any number of episodes.")
    assert read_comparison(tmp_path).verdict == resumed.verdict
    assert [run.judged for run in read_cell(tmp_path).runs] == [10, None, 40]


def test_another_baseline_or_margin_is_told_forever(tmp_path):
    both = {"policies": ["random", "reach_ik"], "out": tmp_path, "env_options": SHORT, "episodes": 10}
    assert not told_before(compare(**both))
    assert told_before(compare(**both, baseline="random")) == ["no baseline, margin 0.02"]
    again = compare(**both, margin=0.1)
    assert told_before(again) == ["baseline random, margin 0.02; no baseline, margin 0.02"]
    assert again.looks == []
    assert "earlier look" not in str(again.verdict)


BOTH: Any = {"policies": ["random", "reach_ik"], "env_options": SHORT}
LOOKED = "after an earlier look at {} episodes, p is too small"


@pytest.mark.slow
def test_looks_survive_overwriting_and_so_do_other_arguments(tmp_path):
    folder: Any = {"out": tmp_path, "overwrite": True}
    compare(**BOTH, episodes=10, baseline="random", out=tmp_path)
    again = compare(**BOTH, episodes=20, **folder)
    assert again.looks == read_comparison(tmp_path).looks == [10]
    assert LOOKED.format(10) in again.verdict.result
    assert told_before(again) == ["baseline random, margin 0.02"]
    twice = compare(**BOTH, episodes=20, **folder)  # with other random numbers: the dice are thrown anew
    assert twice.looks == [10, 20]
    compare(**BOTH, episodes=30, out=tmp_path)
    assert compare(**BOTH, episodes=40, out=tmp_path).looks == [10, 20, 30]


@pytest.mark.slow
def test_a_kill_or_ctrl_c_after_overwriting_forgets_no_look(tmp_path):
    compare(**BOTH, episodes=10, out=tmp_path)

    def end(result):
        raise KeyboardInterrupt

    assert compare(**BOTH, episodes=30, out=tmp_path, overwrite=True, progress=end).interrupted
    code = f"""
import os, armctl
armctl.compare({BOTH["policies"]}, episodes=40, out={str(tmp_path)!r}, env_options={SHORT!r}, overwrite=True,
               progress=lambda result: os._exit(1))
"""
    assert subprocess.run([sys.executable, "-c", code]).returncode == 1
    assert 10 in compare(**BOTH, episodes=40, out=tmp_path).looks


@pytest.mark.slow
def test_looks_at_other_policies_seeds_and_environments_are_none(tmp_path):
    compare(**BOTH, episodes=10, out=tmp_path)
    other: Any = {"out": tmp_path, "overwrite": True}
    assert compare(**BOTH, episodes=20, seed=1, **other).looks == []
    assert compare(**BOTH | {"env_options": {"max_episode_steps": 4}}, episodes=30, seed=1, **other).looks == []
    (tmp_path / "results.sqlite").write_bytes(b"damaged")
    assert compare(**BOTH, episodes=12, **other).looks == []
    three = BOTH | {"policies": [*BOTH["policies"], "reach_ppo"]}
    assert compare(**three, episodes=14, **other).looks == [12]  # two of them were looked at


@pytest.mark.slow
def test_sweeps_and_suites_tell_looks_too_also_overwritten_ones(tmp_path, monkeypatch):
    options: Any = {"out": tmp_path / "sweep", "env_options": SHORT}
    swept = armctl.sweep(BOTH["policies"], disturbances={"payload": [0, 2]}, episodes=10, **options)
    swept = armctl.sweep(BOTH["policies"], disturbances={"payload": [0, 2]}, episodes=12, overwrite=True, **options)
    assert LOOKED.format(10) in str([part.text for part in swept.document().parts if hasattr(part, "text")])
    suite: Any = {"envs": ["ArmReach-v0"], "quick": True, "worlds": 13, "out": tmp_path / "suite"}
    armctl.suite(**suite, episodes=10)
    for result in (armctl.suite(**suite, episodes=12), armctl.suite(**suite, episodes=13, overwrite=True)):
        (verdict,) = result.verdicts
        looks = {12: [10], 13: [10, 12]}[result.episodes]
        assert list(verdict.looks) == looks
        texts = [part.text for part in result.document().parts if hasattr(part, "text")]
        headline = " ".join(texts[:2])
        assert all(f"{count}" in headline.partition("earlier look")[2] for count in looks), headline
        assert "p is too small" in verdict.verdict
        assert "p is too small" in verdict.context


def told_before(comparison):
    prefix = "A verdict was told before by other arguments: "
    return [note.removeprefix(prefix).rstrip(".") for note in comparison.notes if note.startswith(prefix)]


@pytest.mark.parametrize(
    ("cores", "loads", "own", "busy"),
    [
        (2, (0.0, 1.0, 1.0), 1.0, False),
        (2, (0.0, 1.5, 1.0), 1.0, False),
        (2, (0.0, 1.6, 1.0), 1.0, True),
        (2, (3.0, 0.0, 0.0), 1.0, True),
        (2, (0.0, 1.0, 2.0), 1.0, True),
        (2, (0.0, 2.0, 2.0), 1.9, False),
        (64, (9.0, 9.0, 9.0), 1.0, False),
        (2, (None, None, None), 1.0, False),
        (None, (0.0, None, None), None, False),
    ],
)
def test_a_machine_is_busy_by_what_others_do(cores, loads, own, busy):
    before, during, after = loads
    run = Run("a", "", {}, "", cores, {}, 1, 1, before, during, after, own)
    assert run.busy == busy
    assert MAX_BACKGROUND_LOAD * 2 == 0.5


def test_deadlines_on_a_busy_machine_are_blank_with_the_reason(tmp_path, monkeypatch):
    idle = play(tmp_path / "idle")
    assert idle.policies[0].missed_deadlines == 0
    assert NOTE not in " ".join(idle.notes)
    monkeypatch.setattr(os, "getloadavg", lambda: (1000.0, 0.0, 0.0), raising=False)
    busy = play(tmp_path / "busy")
    assert busy.policies[0].missed_deadlines is None
    assert busy.episodes.missed_deadlines.isna().all()
    assert NOTE in " ".join(busy.notes)
    assert NOTE in " ".join(read_comparison(tmp_path / "busy").notes)
    shares = compare(["random"], episodes=2, worlds=2, env_options=SHORT)
    assert NOTE not in " ".join(shares.notes)


def test_without_a_load_average_deadlines_are_judged(monkeypatch):
    monkeypatch.delattr(os, "getloadavg")
    comparison = compare(["random"], episodes=1, env_options=SHORT)
    assert comparison.policies[0].missed_deadlines == 0


def test_evaluate_plays_no_run():
    assert set(armctl.evaluate("random", episodes=1, env_options=SHORT).run) == {""}


def test_every_look_at_fewer_episodes_counts_once():
    judged = (100, None, 57, 100, 200, 200)
    runs = [Run(str(i), "", {}, "", 1, {}, 1, 1, judged=one) for i, one in enumerate(judged)]
    assert earlier_looks(runs) == [57, 100]
    assert earlier_looks(runs[:1]) == earlier_looks([]) == []

import json
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from armctl.agents import read_card
from armctl.core.errors import ResultsError
from armctl.training import trials
from armctl.training.run import log_trial
from armctl.training.trials import COLUMNS, TRIALS, add_trial, progress_of, read_trials, results_of, trial_row

RL = Path(__file__).parents[2] / "rl"


def row(**more):
    return trial_row(
        "reach_ppo", "ppo", "armctl/ArmReach-v0", 3, {"options": {"steps": 7}, "shaping": None}, "failed", **more
    )


def test_a_row_says_what_was_changed_and_how_it_ended(tmp_path):
    add_trial(tmp_path / "runs" / TRIALS, row(note='out of "memory",\nsaid torch') | {"steps": 5})
    (read,) = read_trials(tmp_path / "runs" / TRIALS)
    assert tuple(read) == COLUMNS
    assert json.loads(read["changed"]) == {"options": {"steps": 7}}
    assert (read["ended"], read["note"], read["steps"], read["success"]) == (
        "failed", 'out of "memory",\nsaid torch', "5", "",
    )  # fmt: skip


def test_a_row_without_changes_says_none_and_leaves_unknown_results_empty(tmp_path):
    add_trial(
        tmp_path / TRIALS, trial_row("reach_ppo", "ppo", "armctl/ArmReach-v0", None, {"a": None, "b": {}}, "finished")
    )
    (read,) = read_trials(tmp_path / TRIALS)
    told = {name: value for name, value in read.items() if value}
    assert set(told) == {"date", "recipe", "env", "learner", "ended"}
    assert (read["recipe"], read["learner"], read["ended"]) == ("reach_ppo", "ppo", "finished")


def test_many_writers_lose_no_row(tmp_path):
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda i: add_trial(tmp_path / TRIALS, row(note=str(i))), range(24)))
    rows = read_trials(tmp_path / TRIALS)
    assert sorted(int(one["note"]) for one in rows) == list(range(24))
    assert all(one | {"note": "", "date": ""} == rows[0] | {"note": "", "date": ""} for one in rows)


def test_columns_of_other_versions_are_kept(tmp_path):
    (tmp_path / TRIALS).write_text("date,recipe,mood\n2025-01-01,old,good\n")
    add_trial(tmp_path / TRIALS, row())
    old, new = read_trials(tmp_path / TRIALS)
    assert (old["recipe"], old["mood"], old["success"]) == ("old", "good", "")
    assert (new["recipe"], new["mood"]) == ("reach_ppo", "")


@pytest.mark.parametrize("content", [b"a,b\n1\n", b"a,b\n1,2,3\n", b"\xff\xfe", b'a\n"open'])
def test_a_damaged_file_is_left_as_it_is_and_the_row_is_told(tmp_path, content):
    (tmp_path / TRIALS).write_bytes(content)
    with pytest.raises(ResultsError, match=r"cannot be recorded in .*trials.csv .*its row is .*reach_ppo"):
        add_trial(tmp_path / TRIALS, row())
    assert (tmp_path / TRIALS).read_bytes() == content


@pytest.mark.parametrize("content", [b"policy,episode,success\na,0,1\n", b"recipe\na,b\n", b"\xff\xfe"])
def test_a_file_that_is_no_record_is_told_before_the_training(tmp_path, content):
    """Such as one that `armctl log` has written."""
    (tmp_path / TRIALS).write_bytes(content)
    job: Any = SimpleNamespace()
    refused = pytest.raises(ResultsError, match=r"trials.csv cannot record trainings .*another folder")
    with refused, log_trial(job, 0, tmp_path / "run"):
        pytest.fail("it is trained")
    assert (tmp_path / TRIALS).read_bytes() == content


def test_a_full_disk_loses_nothing(tmp_path, monkeypatch):
    add_trial(tmp_path / TRIALS, row())
    before = (tmp_path / TRIALS).read_bytes()

    def full(path, content):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(trials, "write_atomically", full)
    with pytest.raises(ResultsError, match="No space left on device"):
        add_trial(tmp_path / TRIALS, row())
    assert (tmp_path / TRIALS).read_bytes() == before


def test_an_unfinished_training_tells_how_far_it_got(tmp_path):
    assert progress_of(tmp_path) == {}
    (tmp_path / "curve.csv").write_bytes((RL / "agents" / "reach_ppo.csv").read_bytes())
    assert progress_of(tmp_path)["steps"] == read_card(RL / "agents" / "reach_ppo.json").training_steps


def test_an_interrupted_training_has_the_steps_of_its_newest_checkpoint(tmp_path):
    """An interrupt leaves a checkpoint after the last evaluation."""
    (tmp_path / "curve.csv").write_text("steps,minutes\n0,0.0\n")
    (tmp_path / "checkpoints").mkdir()
    for steps in (0, 4096, 12288):
        (tmp_path / "checkpoints" / f"{steps}.zip").touch()
    assert progress_of(tmp_path)["steps"] == 12288
    (tmp_path / "clock.json").write_text('{"seconds": 90.0}')
    assert progress_of(tmp_path) == {"steps": 12288, "minutes": 1.5}


def test_every_shipped_card_has_its_row():
    known = {one["sha256"]: one for one in read_trials(RL / TRIALS)}
    for path in (*(RL / "agents").glob("*.json"), *(RL / "agents" / "seeds").glob("*.json")):
        card = read_card(path)
        told = known[card.sha256]
        assert (told["recipe"], told["learner"], told["env"]) == (card.recipe, card.learner, card.env)
        for name, value in results_of(card).items():
            assert told[name] == str(value), (path.name, name)


def test_failures_are_recorded_too():
    assert {one["ended"] for one in read_trials(RL / TRIALS)} >= {"finished", "failed"}

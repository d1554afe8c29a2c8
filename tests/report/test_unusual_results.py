"""Of which folders a report can be made, and of which not."""

import os
import re
import shutil
from dataclasses import replace

import pandas as pd
import pytest

from armctl.agents import read_card
from armctl.core.errors import ResultsError
from armctl.core.options import option_value
from armctl.episodes.stored import STORE
from armctl.policies.trainings import card_path
from armctl.report import write_report
from armctl.study import compare, sweep
from armctl.study.results import read_comparison

from ..forgery import change_facts, change_record, rewrite
from ..stores import read_cell
from .pages import OPTIONS, plots_of, text_of


def test_results_read_back_are_those_that_were_written(tmp_path):
    made = compare(["random", "reach_ik"], episodes=10, out=tmp_path, env_options=OPTIONS)
    read = read_comparison(tmp_path)
    pd.testing.assert_frame_equal(read.episodes, made.episodes)
    assert (read.policies, read.differences) == (made.policies, made.differences)
    assert read.env_options == OPTIONS


@pytest.mark.parametrize("value", [3, 0.02, (4, 4), None, True, "ur10", "path/to my.urdf"])
def test_options_survive_as_text(value):
    assert option_value(str(value)) == value


@pytest.mark.parametrize(("text", "value"), [("true", True), ("false", False)])
def test_truth_is_written_as_in_recipes_too(text, value):
    assert option_value(text) is value


def test_an_option_of_a_long_text_is_not_read(folder):
    change_facts(folder, lambda facts: facts.update(env_options={"tolerance": f"[{'1,' * 500}]"}))
    with pytest.raises(ResultsError, match="option tolerance has 1,002 characters, more than 1,000"):
        read_comparison(folder)


def test_what_a_training_took_is_read_back(folder):
    ik, ppo, _ = read_comparison(folder).policies
    cost = read_card(card_path("reach_ppo")).cost
    assert (ik.side, ppo.training) == ("classical", cost)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda folder: shutil.rmtree(folder), "there is no folder"),
        (lambda folder: (folder / STORE).unlink(), "holds no results"),
        (lambda folder: (folder / STORE).write_bytes(b"{"), "is damaged"),
        (lambda folder: change_facts(folder, lambda facts: facts.pop("machine")), "cannot be read as results"),
        (lambda folder: change_record(folder, lambda record: record.clear()), "is unfinished"),
        (lambda folder: change_record(folder, lambda record: record.pop("envs")), "cannot be read as results"),
        (lambda folder: (folder / "report.html").mkdir(), "cannot be written"),
    ],
)
def test_folders_of_which_no_report_can_be_made(folder, spoil, says):
    spoil(folder)
    with pytest.raises(ResultsError, match=says):
        write_report(folder, video=False)
    assert not list(folder.glob("unfinished*"))


def test_a_folder_that_cannot_be_written(folder):
    with pytest.raises(ResultsError, match="cannot be written"):
        write_report(folder, "/proc/report.html", video=False)
    if os.geteuid():  # root may write anywhere
        folder.chmod(0o500)
        with pytest.raises(ResultsError, match="cannot be written"):
            write_report(folder, video=False)
        folder.chmod(0o700)


def unscored(folder):
    """Make the results of an environment that does not say what a success is, and of which little is known."""
    identity, facts, runs, episodes = read_cell(folder)
    facts["notes"] = ["mine/Odd-v0 does not obey its seed: <episodes> differ"]
    unknown = {"missed_deadlines": None}
    results = [replace(one, success=None, metrics=replace(one.metrics, **unknown)) for one in episodes]
    rewrite(folder, identity, facts, results, runs)


def test_an_environment_without_success_is_reported_by_return(folder):
    unscored(folder)
    report = write_report(folder, video=False)
    text = text_of(report)
    assert "does not say what a success is" in text
    assert "does not obey its seed: <episodes> differ" in text
    for word in ("Wilson", "McNemar", "steps to goal", "Success rate", "None", "nan"):
        assert word not in text
    drawn = plots_of(report)
    assert any("reach_ik: return" in name for name in drawn)
    assert re.search(r"The first has the higher return in [\d.]+ % of the episodes .* sign test p = ", text)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda facts: facts["policies"].pop("random"), "does not belong to its episodes"),
        (lambda facts: facts.update(return_bounds=[0.0, 1.0]), "does not belong to its episodes"),
        (lambda facts: facts.update(time_limit=1), "does not belong to its episodes"),
        (lambda facts: facts["notes"].append("\ud800"), "surrogates not allowed"),
    ],
)
def test_facts_that_nobody_wrote(folder, change, says):
    """With the right checksum."""
    change_facts(folder, change)
    with pytest.raises(ResultsError, match=says):
        write_report(folder, video=False)


def test_a_sweep_without_success_is_drawn_by_return(tmp_path):
    options = {"max_episode_steps": 5}
    sweep("random", "Pendulum-v1", disturbances={"delay": [1]}, episodes=2, out=tmp_path, env_options=options)
    assert "Return against the level of delay" in plots_of(write_report(tmp_path, video=False))

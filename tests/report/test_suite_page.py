"""The page of a suite: what it says, that names are shown and not obeyed, and its form in headless Chromium."""

import contextlib
import importlib
import shutil
import sqlite3

import numpy as np
import pytest

from armctl.episodes.stored import STORE
from armctl.report import suite_figures, write_report
from armctl.report.style import Style
from armctl.stats.intervals import Estimate
from armctl.study import suite
from armctl.study.line_up import SuiteSize
from armctl.study.results import UNFINISHED, read_study
from armctl.study.suite_headline import suite_headline

from ..forgery import change_record, forge
from .pages import text_of

REACH = "armctl/ArmReach-v0"
HOSTILE = "<img src=x onerror=alert(1)>_ppo"
LOOK = Style("PPO", "#0072b2")


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    module = importlib.import_module("armctl.study.suite_plan")
    folder = tmp_path_factory.mktemp("suite")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "FULL", SuiteSize(2, ("delay",), (0.25,)))
        patch.setattr(module, "line_up", lambda *_: ("reach_ik", "reach_ppo"))
        suite([REACH], episodes=2, out=folder)
    return folder


@pytest.fixture
def folder(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "suite")


@pytest.mark.slow
def test_the_page_has_the_answer_the_map_and_the_links(folder):
    page = write_report(folder)
    assert page == folder / "report.html"
    text = text_of(page)
    for words in (
        "Of 1 task, by success: no verdict in ArmReach",
        "No verdict from 2 episodes: reach_ik against reach_ppo, success +0.0 points",
        "ArmReach-v0 none delay 1 reach_ik 100 100 reach_ppo 100 100",
        "Brackets: MOVER's 95 % interval", "after Holm's correction for all tasks",
        "every third undisturbed episode selects the best of them",
        "Probability of improvement", "Ranks of families", "Performance profiles", "What success costs",
        f"armctl suite --env {REACH} --episodes 2 --seed 0",
    ):  # fmt: skip
        assert words in text
    assert 'href="ArmReach-v0.html"' in page.read_text()
    assert "Under disturbances" in (folder / "ArmReach-v0.html").read_text()


@pytest.mark.slow
def test_links_lead_from_where_the_page_is(folder, tmp_path):
    page = write_report(folder, tmp_path / "other.html")
    assert 'href="ArmReach-v0.html"' in page.read_text()
    assert (tmp_path / "ArmReach-v0.html").exists()


@pytest.mark.slow
def test_names_and_messages_are_shown_and_not_obeyed(folder):
    forge(folder, "reach_ppo", HOSTILE)

    def change(record):
        record["tasks"][REACH]["failures"] = {"delay": HOSTILE}
        record["failures"] = {"mine/Other-v0": HOSTILE}

    change_record(folder, change)
    page = write_report(folder)
    assert HOSTILE not in page.read_text()
    assert text_of(page).count(HOSTILE) >= 5  # in sentences, map, families and notices
    assert f"mine/Other-v0: {HOSTILE}" in text_of(page)


@pytest.mark.slow
def test_a_suite_without_a_finished_task_is_a_page_too(folder):
    with contextlib.closing(sqlite3.connect(folder / STORE)) as file, file:
        file.execute("UPDATE cell SET facts = NULL")
    assert UNFINISHED in text_of(write_report(folder))


def test_a_task_that_knows_no_disturbance_is_reported_undisturbed(tmp_path):
    suite(["FrozenLake-v1"], episodes=2, out=tmp_path)
    page = write_report(tmp_path)
    assert 'href="FrozenLake-v1.html"' in page.read_text()
    assert "FrozenLake-v1 the environment does not say what a success is." in text_of(page)


def test_the_headline_counts_tasks(finished):
    assert suite_headline([]) == ("No task", "")
    assert suite_headline(read_study(finished).verdicts)[0].startswith("Of 1 task, by success: no verdict in ")


def test_figures_hold_their_numbers():
    points = [suite_figures.CostPoint("p", "t", LOOK, "circle", 0.5, cost) for cost in (0.0, 20.0)]
    plane = suite_figures.cost_plane(points, "minutes", "minutes", 0.1)
    assert [trace.x[0] for trace in plane.data] == [0.1, 20.0]  # what costs nothing is at the axis's beginning
    low, high = plane.layout.xaxis.range
    assert low < np.log10(0.1) < np.log10(20) < high
    rows = suite_figures.intervals(
        {"<b>": Estimate(0.5, 0.25, 0.75), "c": Estimate(0.5, None, None)}, {"<b>": "#000000", "c": "#000000"}
    )
    assert rows.data[0].x == (0.25, 0.75)
    assert rows.data[0].y[0] == "&lt;b&gt;"
    assert suite_figures.cost_plane([], "ms", "ms", 0.1).data == ()


@pytest.fixture(scope="module")
def page(finished, tmp_path_factory):
    return write_report(finished, tmp_path_factory.mktemp("page") / "report.html")


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.parametrize("width", [1280, 390])
def test_the_page_in_a_browser(chromium, page, width):
    complaints = []
    tab = chromium.new_page(viewport={"width": width, "height": 844})
    tab.on("console", lambda message: complaints.append(message.text))
    tab.on("pageerror", lambda error: complaints.append(str(error)))
    tab.goto(page.as_uri(), timeout=120_000)
    tab.wait_for_function("() => document.querySelectorAll('.canvas .trace').length > 8", timeout=120_000)
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    assert complaints == []

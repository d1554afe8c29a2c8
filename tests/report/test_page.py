"""What the HTML report says."""

import json
import re

import numpy as np
import pandas as pd
import pytest

from armctl.agents import read_card
from armctl.policies import sees
from armctl.policies.trainings import card_path
from armctl.report import write_report
from armctl.study import compare

from ..command_line import armctl
from ..forgery import forge
from ..holding_still import HoldsStill
from .pages import OPTIONS, POLICIES, plot_of, plots_of, text_of


def test_verdict_and_how_to_do_it_again(folder):
    text = text_of(write_report(folder, video=False))
    assert "Undecided between" in text
    cost = read_card(card_path("reach_ppo")).cost
    millions, minutes = f"{cost.decisions / 1e6:.3g}", f"{cost.processor_seconds / 60:.1f}"
    updates = f"{cost.gradient_steps:,} gradient steps"
    assert f"was trained for {millions} million decisions and {updates} ({minutes} minutes of processor)" in text
    assert f"{millions} M decisions {updates} {minutes} processor minutes" in " ".join(text.split())
    command = "armctl compare reach_ik reach_ppo random --env armctl/ArmReach-v0 --set max_episode_steps=15 --seed 0"
    assert f"{command} --episodes 12" in text
    assert json.loads((folder / "summary.json").read_text())["versions"]["mujoco"] in text
    assert "There are no videos: armctl report without --no-video" in text


def test_the_headline_is_short_and_has_a_picture_beside_it(folder):
    report = write_report(folder, video=False)
    html = report.read_text()
    head = html[html.index('<div class="told">') : html.index("</header>")]
    assert head.index("<h1>") < head.index('class="cost"') < head.index("Success against decision time")
    dots = {one["name"]: one["y"] for one in plot_of(report, "decision time")["data"] if one.get("name")}
    assert dots["reach_ik"] == [1.0]


def test_nothing_on_the_page_points_elsewhere(folder):
    html = re.sub(r"<script>.*?</script>", "", write_report(folder, video=False).read_text(), flags=re.DOTALL)
    assert re.findall(r'(?:src|href)="(?!data:)[^"]*"|url\(|@import', html) == []
    assert "default-src 'none'" in html


def test_the_report_goes_where_it_is_asked_to(folder, tmp_path):
    assert write_report(folder, tmp_path / "mine.html", video=False) == tmp_path / "mine.html"
    assert not (folder / "report.html").exists()


NAMES = ["<script>alert(1)</script>", '</script><img src=x onerror="alert(1)">', "<b>bold</b> & 'so' {{ 7 * 7 }}"]


@pytest.mark.slow
def test_names_are_shown_and_not_obeyed(folder):
    for name, hostile in zip(POLICIES, NAMES, strict=True):
        forge(folder, name, hostile)
    report = write_report(folder)
    html = re.sub(r"<script>.*?</script>", "", report.read_text(), count=2, flags=re.DOTALL)
    assert "<script>alert" not in report.read_text()
    assert "<img src=x" not in html
    assert "<b>bold" not in html
    assert "{{ 7 * 7 }}" in text_of(report)


def test_one_policy_and_a_single_episode(tmp_path):
    compare("reach_ik", episodes=1, out=tmp_path)
    text = text_of(write_report(tmp_path, video=False))
    assert "reach_ik succeeds in 100.0 % of 1 episodes (2.5 to 100.0 %)." in text
    assert "Pairs of policies" not in text


@pytest.mark.slow
def test_a_few_episodes_have_no_verdict(tmp_path):
    compare(["reach_ik", "random"], episodes=2, out=tmp_path, env_options=OPTIONS)
    assert "No verdict from 2 episodes" in text_of(write_report(tmp_path, video=False))


class Still(HoldsStill):
    """Holds still, but for what happens when the episode `last` or a later one begins."""

    def __init__(self, env, last, happens):
        self.env, self.last, self.happens = env, last, happens

    def reset(self, ids):
        if self.env.episodes.max() >= self.last:
            raise self.happens


@sees("state")
def broken(env):
    return Still(env, 0, RuntimeError("out of ideas"))


@sees("state")
def stopping(env):
    return Still(env, 2, KeyboardInterrupt)


@pytest.mark.slow
def test_an_interrupted_comparison_and_a_failed_policy(tmp_path):
    comparison = compare([broken, "reach_ik", stopping], episodes=5, out=tmp_path, env_options=OPTIONS)
    assert comparison.interrupted
    text = text_of(write_report(tmp_path, video=False))
    assert "The comparison was interrupted" in text
    assert "broken has finished no episode that counts" in text
    assert "out of ideas" in text
    assert "stopping was cut short: its figures are over the first 2 of 5 episodes" in text


def test_no_episode_at_all_is_a_report_too(tmp_path):
    compare([broken], episodes=2, out=tmp_path)
    assert "No episode was finished." in text_of(write_report(tmp_path))


@pytest.mark.slow
def test_a_sweep_has_its_disturbances_first(swept):
    report = write_report(swept, video=False)
    html, drawn = report.read_text(), plots_of(report)
    assert [f"Success against the level of {kind}" for kind in ("noise", "delay")] == list(drawn)[:2]
    lines = [one for one in plot_of(report, "delay")["data"] if one.get("name")]
    assert [line["name"] for line in lines] == POLICIES
    points = pd.read_csv(swept / "sweep.csv")
    bc = points[(points.disturbance == "delay") & (points.policy == "reach_ppo")]
    np.testing.assert_allclose(lines[1]["y"], bc.success)
    assert lines[1]["x"] == ["0", "1", "3"]
    assert "--disturbance noise=0,0.05,0.1 --disturbance delay=0,1,3" in html
    heading = re.search(r"<h1>(.*)</h1>", html)[1]
    assert heading == "Under noise and delay, reach_ik leads."
    assert html.index("<h2>Under disturbances</h2>") < html.index("<h2>Undisturbed</h2>") < html.index("<h2>Results")


@pytest.mark.slow
def test_the_commands_write_it_and_say_where(tmp_path):
    done = armctl("compare", "reach_ik", "--episodes", "1", "--out", "here", "--report", cwd=tmp_path)
    assert "here/report.html is the report" in done.stdout
    assert (tmp_path / "here" / "report.html").stat().st_size > 1e6
    assert (
        "mine.html is the report" in armctl("report", "here", "--out", "mine.html", "--no-video", cwd=tmp_path).stdout
    )
    missing = armctl("report", "elsewhere", cwd=tmp_path, check=False)
    assert (missing.returncode, "there is no folder elsewhere" in missing.stderr) == (2, True)


@pytest.mark.slow
def test_the_page_of_what_was_played_is_that_of_the_folder(tmp_path):
    armctl("suite", "--quick", "--episodes", "2", "--env", "armctl/ArmReach-v0", "--out", "here", cwd=tmp_path)
    pages = [page.name for page in (tmp_path / "here").glob("*.html")]
    (tmp_path / "again").mkdir()
    armctl("report", "here", "--out", "again/report.html", "--no-video", cwd=tmp_path)
    assert sorted(pages) == ["ArmReach-v0.html", "report.html"]
    for name in pages:
        played, read = ((tmp_path / folder / name).read_text() for folder in ("here", "again"))
        assert played.partition("<footer>")[0] == read.partition("<footer>")[0]

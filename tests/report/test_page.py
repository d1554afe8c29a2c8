"""The HTML report: what it holds, of which folders it can be made, and its page in headless Chromium."""

import json
import os
import re
import shutil
from html import unescape
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from armctl.agents import TrainingCost, read_card
from armctl.envs import TaskVectorEnv
from armctl.errors import ConfigurationError, ResultsError
from armctl.evaluation import compare
from armctl.evaluation.reproduce import card_path
from armctl.evaluation.results import read_results
from armctl.files import sealed, unsealed
from armctl.options import option_value
from armctl.policies import sees
from armctl.report import colours, plots, style, videos, write_report
from armctl.report.profile import profile_start

from ..command_line import armctl
from ..forgery import forge, write_sweep
from .pages import text_of

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
POLICIES = ["reach_ik", "reach_ppo", "random"]
OPTIONS = {"max_episode_steps": 15}
"""Enough for the experts: each decision is a picture in a video."""
CURVE = "steps,minutes,success,low,high,return\n1000,0.5,0.25,0.1,0.4,-50\n9000,4.5,0.875,0.7,0.95,60\n"
SWEEP = "disturbance,level,policy,success,low,high,episodes\n" + "".join(
    f"{kind},{level},{policy},{0.9 - level},{0.8 - level},{1 - level},20\n"
    for kind in ("noise", "delay")
    for level in (0, 0.1, 0.3)
    for policy in ("reach_ik", "reach_bc")
)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    compare(POLICIES, episodes=12, worlds=4, out=folder, env_options=OPTIONS)
    return folder


@pytest.fixture
def folder(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "results")


def plots_of(report):
    """The figures, by what they say to those who do not see them."""
    written = re.findall(
        r'aria-label="([^"]*)" style="[^"]*"></div>\s*<script type="application/json">(.*?)</script>',
        report.read_text(),
        re.DOTALL,
    )
    return {unescape(says): json.loads(figure) for says, figure in written}


def plot_of(report, says):
    return next(figure for name, figure in plots_of(report).items() if says in name)


def test_terms_of_the_reward_are_in_the_table_and_add_up(finished):
    episodes = pd.read_csv(finished / "episodes.csv")
    terms = pd.DataFrame(list(episodes.reward_terms.map(json.loads)))
    np.testing.assert_allclose(terms.sum(axis=1), episodes["return"])
    assert (terms.step == -episodes.length).all()
    assert (terms.goal == 100 * episodes.success).all()


def test_results_read_back_are_those_that_were_written(tmp_path):
    made = compare(["random", "reach_ik"], episodes=10, out=tmp_path, env_options=OPTIONS)
    read = read_results(tmp_path)
    pd.testing.assert_frame_equal(read.comparison.episodes, made.episodes)
    assert (read.comparison.policies, read.comparison.paired) == (made.policies, made.paired)
    assert read.comparison.env_options == OPTIONS


@pytest.mark.parametrize("value", [3, 0.02, (4, 4), None, True, "ur10", "path/to my.urdf"])
def test_options_survive_as_text(value):
    assert option_value(str(value)) == value


def test_an_option_of_a_long_text_is_not_read(folder):
    summary = unsealed((folder / "summary.json").read_text())
    summary["env_options"] = {"tolerance": f"[{'1,' * 500}]"}
    (folder / "summary.json").write_text(sealed(summary))
    with pytest.raises(ResultsError, match="option tolerance has 1,002 characters, more than 1,000"):
        read_results(folder)


def test_figures_hold_the_numbers_of_the_summary(folder):
    report = write_report(folder, video=False)
    summary = {policy["policy"]: policy for policy in json.loads((folder / "summary.json").read_text())["policies"]}
    bars = plot_of(report, "reach_ik: success")["data"]
    for bar in bars:
        success = summary[bar["y"][0]]["success"]
        low, high = bar["x"][0] - bar["error_x"]["arrayminus"][0], bar["x"][0] + bar["error_x"]["array"][0]
        np.testing.assert_allclose([bar["x"][0], low, high], [100 * success[name] for name in ("value", "low", "high")])
    assert len(bars) == 3
    episodes = pd.read_csv(folder / "episodes.csv")
    lines = [one for one in plot_of(report, "Share of episodes above")["data"] if one.get("name")]
    for line in lines:
        returns = episodes[episodes.policy == line["name"]]["return"]
        np.testing.assert_allclose(line["y"], [(returns > threshold).mean() for threshold in line["x"]])
    assert (lines[0]["y"][0], len(lines)) == (1, 3)
    *terms, total = plot_of(report, "goal")["data"]
    np.testing.assert_allclose(np.sum([term["x"] for term in terms], axis=0), total["x"])
    np.testing.assert_allclose(total["x"], [one["episode_return"]["value"] for one in summary.values()])
    dots = plot_of(report, "Returns of reach_ik against those of reach_ppo")["data"][1]
    assert sum(size for size, _ in dots["customdata"]) == 12
    ticks = [one for one in plot_of(report, "99th percentile")["data"] if one["mode"] == "markers"]
    for tick, policy in zip(ticks, summary.values(), strict=True):
        expected = [policy[f"decision_ms_{name}"] for name in ("p50", "p99", "max")]
        np.testing.assert_allclose(tick["x"], expected)
    text = text_of(report)
    for policy in summary.values():
        assert f"{100 * policy['success']['value']:.1f} %" in text
        for figure in ("episode_return", "worst_decile", "restricted_steps"):
            assert style.signed(f"{policy[figure]['value']:.1f}") in text


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
    assert "There are no videos. They were left out" in text


def test_a_summary_of_an_older_version_is_read(folder):
    summary = unsealed((folder / "summary.json").read_text())
    for policy in summary["policies"]:
        trained = policy.pop("training")
        policy |= {"training_steps": trained["steps"], "training_minutes": trained["minutes"] or 0.0}
        del policy["decision_ms_mean"], policy["decision_seconds"]
    (folder / "summary.json").write_text(sealed(summary))
    ik, ppo, _ = read_results(folder).comparison.policies
    cost = read_card(card_path("reach_ppo")).cost
    assert (ik.learned, ppo.training) == (False, TrainingCost(cost.steps, cost.minutes))
    text = text_of(write_report(folder, video=False))
    assert f"was trained for {cost.steps / 1e6:.3g} million steps ({cost.minutes:.1f} minutes)" in text


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


def test_names_are_shown_and_not_obeyed(folder):
    for name, hostile in zip(POLICIES, NAMES, strict=True):
        forge(folder, name, hostile)
    report = write_report(folder)
    html = re.sub(r"<script>.*?</script>", "", report.read_text(), count=2, flags=re.DOTALL)
    assert "<script>alert" not in report.read_text()
    assert "<img src=x" not in html
    assert "<b>bold" not in html
    assert "{{ 7 * 7 }}" in text_of(report)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda folder: shutil.rmtree(folder), "there is no folder"),
        (lambda folder: (folder / "comparison.json").unlink(), "holds no results"),
        (lambda folder: (folder / "summary.json").unlink(), "is unfinished"),
        (lambda folder: (folder / "summary.json").write_text("{"), "cannot be read"),
        (lambda folder: (folder / "summary.json").write_text("[]"), "cannot be read"),
        (lambda folder: (folder / "comparison.json").write_bytes(b"\xff\xfe"), "cannot be read"),
        (lambda folder: (folder / "episodes.csv").unlink(), "cannot be read"),
        (lambda folder: (folder / "episodes.csv").write_text("policy\nrandom\n"), "line 1"),
        (
            lambda folder: (folder / "decisions.csv").write_text("policy,episode,checksum,decision_ms\n"),
            "not belong to the episodes",
        ),
        (lambda folder: write_sweep(folder, "level\n1\n"), "no column disturbance"),
        (lambda folder: (folder / "sweep.csv").write_text(SWEEP), "sweep.json"),
        (
            lambda folder: (write_sweep(folder, SWEEP), (folder / "sweep.csv").write_text(SWEEP.replace("0.9", "1.0"))),
            "was changed",
        ),
        (lambda folder: (folder / "report.html").mkdir(), "cannot be written"),
    ],
)
def test_folders_of_which_no_report_can_be_made(folder, spoil, says):
    spoil(folder)
    with pytest.raises(ResultsError, match=says):
        write_report(folder, video=False)
    assert not list(folder.glob("unfinished*"))


def test_a_damaged_reward_term_is_told(folder):
    text = (folder / "episodes.csv").read_text()
    (folder / "episodes.csv").write_text(text.replace('""goal""', '""goal', 1))
    with pytest.raises(ResultsError, match="damaged in line 2"):
        write_report(folder, video=False)


def test_a_folder_that_cannot_be_written(folder):
    with pytest.raises(ResultsError, match="cannot be written"):
        write_report(folder, "/proc/report.html", video=False)
    if os.geteuid():  # root may write anywhere
        folder.chmod(0o500)
        with pytest.raises(ResultsError, match="cannot be written"):
            write_report(folder, video=False)
        folder.chmod(0o700)


def test_one_policy_and_a_single_episode(tmp_path):
    compare("reach_ik", episodes=1, out=tmp_path)
    text = text_of(write_report(tmp_path, video=False))
    assert "reach_ik succeeds in 100.0 % of 1 episodes (2.5 to 100.0 %)." in text
    assert "Pairs of policies" not in text


def test_a_few_episodes_have_no_verdict(tmp_path):
    compare(["reach_ik", "random"], episodes=2, out=tmp_path, env_options=OPTIONS)
    assert "No verdict from 2 episodes" in text_of(write_report(tmp_path, video=False))


class Still:
    """Holds still, but for what happens when the episode `last` begins."""

    sees = "observation"
    training_steps = 0

    def __init__(self, env, last, happens):
        self.env, self.last, self.happens = env, last, happens

    def reset(self, ids):
        if self.env.episodes.max() == self.last:
            raise self.happens

    def act(self, observations):
        return observations[:, 3:9]


@sees("state")
def broken(env):
    return Still(env, 0, RuntimeError("out of ideas"))


@sees("state")
def stopping(env):
    return Still(env, 2, KeyboardInterrupt)


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


def test_learning_curves_of_agents_beside_the_others(tmp_path):
    agents = card_path("reach_ppo")
    mine = tmp_path / "runs" / "mine-0"
    mine.mkdir(parents=True)
    for suffix in (".json", ".onnx"):
        shutil.copy(agents.with_suffix(suffix), mine / f"agent{suffix}")
    (mine / "curve.csv").write_text(CURVE)
    agent = str(mine / "agent.json")
    compare(["reach_ik", agent], episodes=2, out=tmp_path / "results")
    report = write_report(tmp_path / "results", video=False)
    ik, curve = (one for one in plot_of(report, "decisions of training")["data"] if one.get("name"))
    assert (curve["name"], curve["x"], curve["y"]) == ("mine-0", [1000, 9000], [0.25, 0.875])
    assert "mine-0 is not seen to reach the 100.0 % of reach_ik: 87.5 % [" in text_of(report)
    assert (ik["name"], ik["y"], ik["line"]["dash"]) == ("reach_ik", [1, 1], "dot")
    harder = {"disturbances": {"noise": 0.02}}
    compare(["reach_ik", agent], episodes=2, out=tmp_path / "harder", env_options=harder)  # no curve is of this
    assert "87.5 %" not in text_of(write_report(tmp_path / "harder", video=False))
    (mine / "curve.csv").write_text("steps\n1\n")
    assert "curve.csv cannot be read: it has no column minutes" in text_of(
        write_report(tmp_path / "results", video=False)
    )


def test_a_sweep_with_and_without_its_undisturbed_comparison(folder, tmp_path):
    sweep = tmp_path / "sweep"
    sweep.mkdir()
    write_sweep(sweep, SWEEP)
    report = write_report(sweep)
    assert list(plots_of(report)) == [f"Success against the level of {kind}" for kind in ("noise", "delay")]
    lines = [one for one in plot_of(report, "delay")["data"] if one.get("name")]
    assert [line["name"] for line in lines] == ["reach_ik", "reach_bc"]
    np.testing.assert_allclose(lines[1]["y"], [0.9, 0.8, 0.6])
    assert lines[1]["x"] == ["0", "0.1", "0.3"]
    shutil.copytree(folder, sweep / "none")
    again = write_report(sweep, video=False)
    assert "--disturbance noise=0,0.1,0.3 --disturbance delay=0,0.1,0.3" in again.read_text()
    html = again.read_text()
    assert re.search(r"<h1>(.*)</h1>", html)[1] == "Under noise and delay, nobody is shown to fall behind."
    assert html.index("<h2>Under disturbances</h2>") < html.index("<h2>Undisturbed</h2>") < html.index("<h2>Results")
    both = plots_of(again)
    assert len(both) == len(plots_of(write_report(folder, video=False))) + 2


def test_the_commands_write_it_and_say_where(tmp_path):
    done = armctl("compare", "reach_ik", "--episodes", "1", "--out", "here", "--report", cwd=tmp_path)
    assert "here/report.html is the report" in done.stdout
    assert (tmp_path / "here" / "report.html").stat().st_size > 1e6
    assert (
        "mine.html is the report" in armctl("report", "here", "--out", "mine.html", "--no-video", cwd=tmp_path).stdout
    )
    missing = armctl("report", "elsewhere", cwd=tmp_path, check=False)
    assert (missing.returncode, "there is no folder elsewhere" in missing.stderr) == (2, True)


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.01234, "0.012"), (9.96, "10"), (99.7, "100"), (1234.5, "1,234"), (-0.5, "\u22120.5"), (0, "0")],
)
def test_numbers_are_short_and_plain(value, text):
    assert style.number(value, 2) == text


def test_policies_are_told_apart():
    names = ["random", "runs/ppo-0/agent.json", "runs/ppo-1/agent.onnx", "shipped/reach_bc.json", *map(str, range(9))]
    look = style.looks(names)
    assert [look[name].label for name in names[:4]] == ["random", "ppo-0", "ppo-1", "reach_bc"]
    assert len({(one.colour, one.dash) for one in look.values()}) == len(names)
    assert style.looks(["a/x/agent.json", "b/x/agent.json"])["a/x/agent.json"].label == "a/x/agent.json"


def test_colours_are_told_apart_and_readable_on_white_and_on_dark():
    for palette in (colours.COLOURS, colours.TERM_COLOURS):
        dark = [colours.DARK.get(colour, colour) for colour in palette]
        assert len(set(dark)) == len(palette)
        for colour in dark:
            assert contrast(colour, colours.DARK[colours.PAPER]) > 3.5
    for ink in (colours.INK, colours.PALE, colours.ALARM):
        assert contrast(ink, colours.PAPER) > 4.4
        assert contrast(colours.DARK[ink], colours.DARK[colours.PAPER]) > 4.5
    assert colours.DARK[colours.faint("#0072b2")] == colours.faint(colours.DARK["#0072b2"])


def contrast(one, other):
    """Of two colours #rrggbb, as the Web Content Accessibility Guidelines define it."""
    lights = []
    for colour in (one, other):
        parts = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        lights.append(0.05 + linear @ (0.2126, 0.7152, 0.0722))
    return max(lights) / min(lights)


def test_no_colour_of_a_figure_is_forgotten_on_a_dark_page(folder):
    write_sweep(folder, SWEEP)
    readable = {*colours.TERM_COLOURS, "rgba(0,0,0,0)", *colours.DARK}
    for figure in plots_of(write_report(folder, video=False)).values():
        used = re.findall(r"#[0-9a-fA-F]{6}\b|rgba\([^)]*\)|\bwhite\b|\bblack\b", json.dumps(figure))
        assert set(used) <= readable


def episodes_of(**returns):
    return {
        name: [SimpleNamespace(total_reward=float(earned)) for earned in values] for name, values in returns.items()
    }


@pytest.mark.parametrize(
    ("returns", "start"),
    [
        ({"good": [60, 80, 95], "fair": [62, 80], "far": [-100] * 3}, 60),  # a policy that is far below
        ({"good": [60, 80, 95], "fair": [62, 80, 40], "low": [20, 30]}, None),  # all are near
        ({"good": range(60, 100), "fair": [-100, *range(60, 100)]}, 60),  # one failure
        ({"good": [-100] * 6 + [60, 90], "fair": [-100] * 7 + [70]}, None),  # the best policy fails most of the time
        ({"only": [1.0, 1.0]}, None),
        ({"only": [-50.0, *range(90, 99)]}, 90),
        ({"good": range(50, 90), "low": [-1000, *range(45, 80)], "lowest": range(-500, 40)}, 45),
    ],
)
def test_a_profile_begins_where_policies_differ(returns, start):
    assert profile_start(episodes_of(**returns)) == start


def test_the_profile_says_what_it_leaves_out(finished):
    report = write_report(finished, finished / "profile.html", video=False)
    figure = plot_of(report, "Share of episodes above")
    returns = pd.read_csv(finished / "episodes.csv")["return"]
    low, high = figure["layout"]["xaxis"]["range"]
    assert low > returns.min() + 50
    assert high > returns.max()
    assert "among them all of random" in text_of(report)
    assert "Show all" in text_of(report)


def unscored(folder):
    """Make the results of an environment that does not say what a success is, and of which little is known."""
    summary = unsealed((folder / "summary.json").read_text())
    for policy in summary["policies"]:
        policy |= dict.fromkeys(("success", "steps_to_goal", "optimality_gap", "missed_deadlines"))
    for pair in summary["paired"]:
        pair |= {"mcnemar_p": None, "only_a": 0, "only_b": 0, "steps_difference": None}
    summary["notes"] = ["mine/Odd-v0 does not obey its seed: <episodes> differ"]
    (folder / "summary.json").write_text(sealed(summary))


def test_an_environment_without_success_is_reported_by_return(folder):
    unscored(folder)
    write_sweep(
        folder,
        "disturbance,level,policy,success,low,high,return,return_low,return_high,episodes\n"
        + "".join(f"noise,{i},random,,,,{-i},{-i - 1},{1 - i},20\n" for i in range(3)),
    )
    report = write_report(folder, video=False)
    text = text_of(report)
    assert "does not say what a success is" in text
    assert "does not obey its seed: <episodes> differ" in text
    for word in ("Wilson", "McNemar", "steps to goal", "Success rate", "None", "nan"):
        assert word not in text
    drawn = plots_of(report)
    assert any("reach_ik: return" in name for name in drawn)
    assert "Return against the level of noise" in drawn
    assert re.search(r"The first is better in [\d.]+ % of the episodes", text)


def test_episodes_to_show(finished):
    episodes = read_results(finished).episodes
    together = videos.most_different(episodes)
    assert [result.policy for result in together] == POLICIES
    assert len({result.episode for result in together}) == 1
    for result in videos.worst(episodes):
        assert result.total_reward == min(one.total_reward for one in episodes[result.policy])
    assert videos.most_different({"reach_ik": episodes["reach_ik"]}) == []


def needs_opengl():
    from armctl.simulation import Camera

    env = plots.make_worlds("armctl/ArmReach-v0", 1)
    assert isinstance(env, TaskVectorEnv)
    try:
        Camera(env.task.simulation.model, env.task.camera, 16, 16).close()
    except ConfigurationError as error:
        pytest.skip(f"no OpenGL: another test checks what is said then ({error})")


@pytest.mark.slow
def test_videos_show_the_episodes_of_the_table(finished, tmp_path):
    needs_opengl()
    import imageio.v3 as imageio

    results = read_results(finished)
    together = videos.most_different(results.episodes)
    clips = videos.film(results, together)
    assert [clip.problem for clip in clips] == [""] * 3
    frames = [imageio.imread(clip.video, extension=".mp4") for clip in clips]
    assert len({one.shape for one in frames}) == 1
    longest = max(result.length for result in together)
    assert len(frames[0]) > longest + 1
    for result, shown in zip(together, frames, strict=True):
        assert np.abs(shown[0].astype(int) - shown[result.length]).max() > 50  # the arm has moved
        assert np.abs(shown[-1].astype(int) - shown[result.length]).mean() < 2  # and stands still in the end


def test_a_replay_that_goes_otherwise_is_told(finished):
    needs_opengl()
    from dataclasses import replace

    results = read_results(finished)
    (clip,) = videos.film(results, [replace(results.episodes["reach_ik"][0], outcome="fell")])
    assert clip.problem.startswith("Played again: reached after")
    assert clip.video


@pytest.mark.slow
def test_policies_that_are_gone_are_told_and_the_others_shown(folder):
    needs_opengl()
    forge(folder, "reach_ppo", "gone/agent.json")
    report = write_report(folder)
    assert text_of(report).count("No video: there is no agent gone/agent.json") == 2
    assert report.read_text().count("<video") == 4


def test_without_opengl_the_report_says_so(folder, monkeypatch):
    def none(*arguments):
        raise ConfigurationError("pictures need OpenGL, and MuJoCo found none")

    monkeypatch.setattr(videos, "Camera", none)
    report = write_report(folder)
    assert "There are no videos. pictures need OpenGL" in text_of(report)
    assert "<video" not in report.read_text()


def look_at_the_switches(tab):
    """The theme follows the system and its switch, which is remembered; the profile shows all when asked to."""
    paper = "getComputedStyle(document.querySelector('section')).backgroundColor"
    ink = "document.querySelector('.canvas .xtick text').style.fill"
    theme = tab.locator("#theme")
    tab.emulate_media(color_scheme="dark")
    tab.wait_for_function(f"() => {ink} === 'rgb(230, 234, 238)'")
    assert (tab.evaluate(paper), theme.inner_text()) == ("rgb(23, 28, 33)", "Light")
    theme.click()
    tab.wait_for_function(f"() => {ink} === 'rgb(31, 41, 51)'")
    assert (tab.evaluate(paper), theme.inner_text()) == ("rgb(255, 255, 255)", "Dark")
    tab.reload()
    tab.wait_for_function("() => document.getElementById('theme').textContent === 'Dark'")
    assert tab.evaluate(paper) == "rgb(255, 255, 255)"
    tab.emulate_media(color_scheme="light")
    tab.wait_for_function("() => document.querySelectorAll('.canvas .main-svg').length > 0")
    shown = "document.querySelector('button.axis').closest('.plot').querySelector('.canvas').layout.xaxis.range[0]"
    least = tab.evaluate(shown)
    tab.locator("button.axis").click()
    assert tab.evaluate(shown) < least - 50
    tab.locator("button.axis").click()
    assert tab.evaluate(shown) == least
    for player in tab.locator(".clip.playable").all():
        assert player.locator("video").get_attribute("controls") is None
        assert player.locator("button").bounding_box()["y"] >= sum(
            player.locator("video").bounding_box()[edge] for edge in ("y", "height")
        )


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt-get install chromium")
@pytest.mark.parametrize("width", [1280, 390])
def test_the_page_in_a_browser(folder, tmp_path, width):
    playwright = pytest.importorskip("playwright.sync_api", reason="no Playwright here: pip install playwright")
    write_sweep(folder, SWEEP)
    report = write_report(folder)
    assert report.stat().st_size < 15e6
    requests, complaints = [], []
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        tab = browser.new_page(viewport={"width": width, "height": 844})
        tab.on("request", lambda request: requests.append(request.url))
        tab.on("console", lambda message: complaints.append(message.text))
        tab.on("pageerror", lambda error: complaints.append(str(error)))
        tab.goto(report.as_uri(), timeout=120_000)
        drawn = (
            "() => [...document.querySelectorAll('.canvas')].every(canvas => canvas.querySelector('.trace, .point'))"
        )
        tab.wait_for_function(drawn, timeout=120_000)
        assert tab.locator(".canvas").count() == len(plots_of(report)) == 11
        assert tab.evaluate("document.documentElement.scrollWidth") <= width
        beyond = (
            "[...document.querySelectorAll('section, .wide')].filter(one => one.scrollWidth > one.clientWidth).length"
        )
        assert tab.evaluate(beyond) == 0
        clips = tab.locator("video")
        if clips.count():
            tab.wait_for_function("() => [...document.querySelectorAll('video')].every(clip => clip.duration > 0.5)")
            tab.locator(".together").scroll_into_view_if_needed()
            tab.wait_for_function("() => document.querySelector('video').currentTime > 0.2")
            shown = tab.evaluate("[...document.querySelectorAll('.together video')].map(clip => clip.currentTime)")
            assert max(shown) - min(shown) < 0.5
        else:
            assert "OpenGL" in tab.locator("body").inner_text()
        look_at_the_switches(tab)
        wide = "[...document.querySelectorAll('.canvas .main-svg')].map(svg => svg.getBoundingClientRect().width)"
        tab.evaluate("dispatchEvent(new Event('beforeprint'))")
        assert max(tab.evaluate(wide)) <= 680
        tab.evaluate("dispatchEvent(new Event('afterprint'))")
        pdf = tab.pdf(prefer_css_page_size=True)
        assert pdf.startswith(b"%PDF")
        assert 3 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 12
        browser.close()
    assert {url for url in requests if not url.startswith("data:")} == {report.as_uri()}
    assert complaints == []


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda summary: summary["paired"][0].update(a="stranger"), "does not belong to the episodes"),
        (lambda summary: summary["notes"].append("\ud800"), "surrogates not allowed"),
    ],
)
def test_a_summary_that_nobody_wrote(tmp_path, change, says):
    """With the right checksum, these ended in tracebacks."""
    compare(["random", "reach_ik"], episodes=5, out=tmp_path, env_options=OPTIONS)
    summary = unsealed((tmp_path / "summary.json").read_text())
    change(summary)
    (tmp_path / "summary.json").write_text(sealed(summary))
    with pytest.raises(ResultsError, match=says):
        write_report(tmp_path, video=False)


def test_a_sweep_has_names(tmp_path):
    write_sweep(tmp_path, "disturbance,level,policy,success,low,high\ndelay,1,,0.5,0.4,0.6\n")
    with pytest.raises(ResultsError, match="a row without a name"):
        write_report(tmp_path, video=False)

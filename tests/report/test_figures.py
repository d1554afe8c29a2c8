"""The figures of the report."""

import itertools
import json
import re
import shutil
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from armctl.policies.trainings import card_path
from armctl.report import colours, style, suite_figures, write_report
from armctl.report.profile import profile_start
from armctl.study import compare

from .pages import plot_of, plots_of, text_of


def test_terms_of_the_reward_are_in_the_table_and_add_up(finished):
    episodes = pd.read_csv(finished / "episodes.csv")
    terms = pd.DataFrame(list(episodes.reward_terms.map(json.loads)))
    np.testing.assert_allclose(terms.sum(axis=1), episodes["return"])
    assert (terms.step == -episodes.length).all()
    assert (terms.goal == 100 * episodes.success).all()


@pytest.mark.slow
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


CURVE = "steps,minutes,success,low,high,return\n1000,0.5,0.25,0.1,0.4,-50\n9000,4.5,0.875,0.7,0.95,60\n"


@pytest.mark.slow
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
    assert "mine-0 does not reach the 100.0 % of reach_ik: its best in" in text_of(report)
    assert (ik["name"], ik["y"], ik["line"]["dash"]) == ("reach_ik", [1, 1], "dot")
    harder = {"disturbances": {"noise": 0.02}}
    compare(["reach_ik", agent], episodes=2, out=tmp_path / "harder", env_options=harder)  # no curve is of this
    assert "87.5 %" not in text_of(write_report(tmp_path / "harder", video=False))
    (mine / "curve.csv").write_text("steps\n1\n")
    assert "curve.csv cannot be read: it has no column minutes" in text_of(
        write_report(tmp_path / "results", video=False)
    )


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.01234, "0.012"), (9.96, "10"), (99.7, "100"), (1234.5, "1,234"), (-0.5, "\u22120.5"), (0, "0")],
)
def test_numbers_are_short_and_plain(value, text):
    assert style.number(value, 2) == text


def test_policies_are_told_apart():
    names = ["random", "runs/ppo-0/agent.json", "runs/ppo-1/agent.onnx", "shipped/reach_bc.json", *map(str, range(9))]
    styles = style.styles_of(names)
    assert [styles[name].label for name in names[:4]] == ["random", "ppo-0", "ppo-1", "reach_bc"]
    assert len({(one.colour, one.dash) for one in styles.values()}) == len(names)
    assert style.styles_of(["a/x/agent.json", "b/x/agent.json"])["a/x/agent.json"].label == "a/x/agent.json"


def test_colours_are_told_apart_and_readable_on_white_and_on_dark():
    for palette in (colours.COLOURS, colours.TERM_COLOURS, colours.FAMILY_COLOURS):
        dark = [colours.DARK.get(colour, colour) for colour in palette]
        assert len(set(dark)) == len(palette)
        for colour in dark:
            assert contrast(colour, colours.DARK[colours.PAPER]) > 3.5
    for ink in (colours.INK, colours.PALE, colours.ALARM):
        assert contrast(ink, colours.PAPER) > 4.4
        assert contrast(colours.DARK[ink], colours.DARK[colours.PAPER]) > 4.5
    assert colours.DARK[colours.faint("#0072b2")] == colours.faint(colours.DARK["#0072b2"])


def test_no_two_families_look_the_same():
    """Their distance in CIELAB is above 20, ten times what is just noticeable, on a white page and on a dark one."""
    names = [str(i) for i in range(len(colours.FAMILY_COLOURS))]
    used = [style.colour for style in suite_figures.family_styles(names).values()]
    for palette in (used, [colours.DARK.get(colour, colour) for colour in used]):
        for one, other in itertools.combinations(palette, 2):
            assert np.linalg.norm(lab(one) - lab(other)) > 20, (one, other)


def lab(colour):
    """Return CIELAB coordinates of a colour #rrggbb, for daylight (D65)."""
    parts = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ linear
    xyz /= (0.9505, 1.0, 1.089)
    x, y, z = np.where(xyz > 216 / 24389, np.cbrt(xyz), (24389 / 27 * xyz + 16) / 116)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def contrast(one, other):
    """Of two colours #rrggbb, as the Web Content Accessibility Guidelines define it."""
    lights = []
    for colour in (one, other):
        parts = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        lights.append(0.05 + linear @ (0.2126, 0.7152, 0.0722))
    return max(lights) / min(lights)


@pytest.mark.slow
def test_no_colour_of_a_figure_is_forgotten_on_a_dark_page(swept):
    readable = {*colours.TERM_COLOURS, "rgba(0,0,0,0)", *colours.DARK}
    for figure in plots_of(write_report(swept, video=False)).values():
        used = re.findall(r"#[0-9a-fA-F]{6}\b|rgba\([^)]*\)|\bwhite\b|\bblack\b", json.dumps(figure))
        assert set(used) <= readable


def episodes_of(**returns):
    return {
        name: SimpleNamespace(column=lambda _, values=values: np.array(values, dtype=float))
        for name, values in returns.items()
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


@pytest.mark.slow
def test_the_profile_says_what_it_leaves_out(finished, tmp_path):
    report = write_report(finished, tmp_path / "profile.html", video=False)
    figure = plot_of(report, "Share of episodes above")
    returns = pd.read_csv(finished / "episodes.csv")["return"]
    low, high = figure["layout"]["xaxis"]["range"]
    assert low > returns.min() + 50
    assert high > returns.max()
    assert "among them all of random" in text_of(report)
    assert "Show all" in text_of(report)

"""The episodes that the report shows in videos."""

import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.report import videos, write_report
from armctl.study.results import read_comparison

from ..forgery import forge
from .pages import POLICIES, text_of


@pytest.mark.slow
def test_episodes_to_show(finished):
    episodes = read_comparison(finished).counted
    together = videos.largest_difference(episodes)
    assert [result.policy for result in together] == POLICIES
    assert len({result.episode for result in together}) == 1
    for result in videos.lowest_returns(episodes):
        assert result.total_reward == min(one.total_reward for one in episodes[result.policy])
    assert videos.largest_difference({"reach_ik": episodes["reach_ik"]}) == []


@pytest.mark.slow
@pytest.mark.opengl
def test_videos_show_the_episodes_of_the_table(finished, tmp_path):
    import imageio.v3 as imageio

    results = read_comparison(finished)
    together = videos.largest_difference(results.counted)
    clips = videos.film(results, together)
    assert [clip.problem for clip in clips] == [""] * 3
    frames = [imageio.imread(clip.video, extension=".mp4") for clip in clips]
    assert len({one.shape for one in frames}) == 1
    longest = max(result.length for result in together)
    assert len(frames[0]) > longest + 1
    for result, shown in zip(together, frames, strict=True):
        assert np.abs(shown[0].astype(int) - shown[result.length]).max() > 50  # the arm has moved
        assert np.abs(shown[-1].astype(int) - shown[result.length]).mean() < 2  # and stands still in the end


@pytest.mark.slow
@pytest.mark.opengl
def test_a_replay_that_goes_otherwise_is_told(finished):
    from dataclasses import replace

    results = read_comparison(finished)
    (clip,) = videos.film(results, [replace(results.counted["reach_ik"][0], outcome="fell")])
    assert clip.problem.startswith("Played again: reached after")
    assert clip.video


@pytest.mark.slow
@pytest.mark.opengl
def test_policies_that_are_gone_are_told_and_the_others_shown(folder):
    forge(folder, "reach_ppo", "gone/agent.json")
    report = write_report(folder)
    assert text_of(report).count("No video: there is no agent gone/agent.json") == 2
    assert report.read_text().count("<video") == 4


@pytest.mark.slow
def test_without_opengl_the_report_says_so(folder, monkeypatch):
    def none(*arguments):
        raise ConfigurationError("pictures need OpenGL, and MuJoCo found none")

    monkeypatch.setattr(videos, "Camera", none)
    report = write_report(folder)
    assert "There are no videos: pictures need OpenGL" in text_of(report)
    assert "<video" not in report.read_text()

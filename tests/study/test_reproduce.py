import functools
import json
import re
import shutil

import numpy as np
import pytest
from scipy.stats import binomtest
from typer.testing import CliRunner

from armctl.agents import read_card
from armctl.cli import app
from armctl.core.errors import AgentFileError, ConfigurationError
from armctl.policies.trainings import card_path
from armctl.report.reproduction import reproduction_document
from armctl.rollout import evaluate
from armctl.stats.unpaired import unconditional
from armctl.study.reproduce import Reproduction, evaluation_of, reproduce


@pytest.fixture
def agent(tmp_path):
    """A copy of the shipped agent whose card claims what it does in 30 episodes, with the figures of older cards."""
    for suffix in (".json", ".onnx"):
        shutil.copy(card_path("reach_ppo").with_suffix(suffix), tmp_path / f"agent{suffix}")
    path = tmp_path / "agent.json"
    found = dict(evaluated(30, read_card(path).evaluation.seed))
    edit(path, **found)
    return path


@functools.cache
def evaluated(episodes, seed):
    """The items of the evaluation of the shipped `reach_ppo`."""
    played = evaluate("reach_ppo", episodes=episodes, seed=seed, worlds=episodes, lower_bound_steps=False)
    return tuple(evaluation_of(played, seed).model_dump().items())


def edit(path, **changes):
    card = json.loads(path.read_text())
    card["evaluation"] = None if "nothing" in changes else card["evaluation"] | changes
    path.write_text(json.dumps(card))


@pytest.mark.slow
def test_a_shipped_agent_does_as_its_card_says(agent):
    again = reproduce(agent)
    assert (again.agrees, again.differences) == (True, [])
    assert again.measured == again.claimed == read_card(agent).evaluation
    assert reproduce(agent.with_suffix(".onnx"), worlds=7).measured == again.measured
    other = reproduce(agent, seed=77)
    assert (other.measured.seed, other.agrees) == (77, True)
    assert other.measured.mean_steps_to_goal != again.measured.mean_steps_to_goal


@pytest.mark.one_case
@pytest.mark.parametrize(
    "change",
    [
        {"success_rate": 29 / 30}, {"success_interval": (0.9, 1.0)}, {"mean_return": 85.0}, {"mean_steps_to_goal": 1.0},
        {"mean_steps_to_goal": None}, {"mean_steps": 1.0}, {"std_return": 0.5}, {"std_steps": 0.5},
        {"digest": "0" * 64}, {"episodes": 29},
    ],
    ids=str,
)  # fmt: skip
def test_a_card_that_claims_anything_else_is_found_out(agent, change):
    """Also figures that no test could tell apart: the episodes are the same."""
    edit(agent, **change)
    again = reproduce(agent)
    assert not again.agrees
    if "episodes" not in change:
        assert [one.figure for one in again.differences] == list(change)
    (remark,) = reproduction_document([again]).parts[1:]
    assert "does not agree with its card" in remark.text


def test_the_slightest_difference_is_told_with_its_size(agent):
    mean = read_card(agent).evaluation.mean_return
    edit(agent, mean_return=np.nextafter(mean, 0))
    remark = reproduction_document([reproduce(agent)]).parts[1].text
    assert re.search(r"return [\d.]+ on the card, [\d.]+ now \(\+1\.42e-14\)\. Other versions or processors", remark)


def test_a_card_of_an_older_version_claims_only_what_it_has(agent):
    edit(agent, mean_steps=None, std_return=None, std_steps=None, digest=None)
    assert reproduce(agent).agrees


def test_a_card_that_boasts_is_found_out(agent):
    edit(agent, success_rate=0.5, success_interval=(0.4, 0.6))
    assert not reproduce(agent).agrees
    result = CliRunner().invoke(app, ["reproduce", str(agent)])
    assert result.exit_code == 1
    assert "50.0 %" in result.stdout


def test_what_cannot_be_reproduced_is_refused(agent, tmp_path):
    with pytest.raises(ConfigurationError, match=r"no agent 'reach_pop'.*Did you mean 'reach_ppo'"):
        reproduce("reach_pop")
    with pytest.raises(ConfigurationError, match=r"reach_ik is not a learned agent: .*reach_bc.*reach_sac"):
        reproduce("reach_ik")
    with pytest.raises(AgentFileError, match="cannot be read"):
        reproduce(tmp_path / "nothing.json")
    edit(agent, nothing=True)
    with pytest.raises(AgentFileError, match="no evaluation"):
        reproduce(agent)


CARDS = sorted(card_path("reach_ppo").parent.glob("*.json"))
CHEAP = ("reach_", "moving_", "obstacles_", "pose_", "scenes_")
"""Agents of short episodes and cheap decisions, but for `reach_td_mpc2`, which plans for each."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "card",
    [
        pytest.param(card, id=card.stem, marks=() if card.stem in ("reach_ppo", "bridge_ppo") else pytest.mark.slow)
        for card in CARDS
    ],
)
def test_every_shipped_agent_does_about_what_its_card_says(card, tmp_path, sized):
    """On some of the episodes: `armctl reproduce` plays all."""
    n = sized(12, 40) if card.stem.startswith(CHEAP) and card.stem != "reach_td_mpc2" else sized(4, 12)
    for suffix in (".json", ".onnx"):
        shutil.copy(card.with_suffix(suffix), tmp_path / f"agent{suffix}")
    edit(tmp_path / "agent.json", episodes=n)
    found = reproduce(tmp_path / "agent.json").measured
    claimed = read_card(card).evaluation
    assert binomtest(round(n * found.success_rate), n, claimed.success_rate).pvalue > 1e-3


def claims(won, returns, steps):
    rate = float(np.mean(won))
    return read_card(card_path("reach_ppo")).evaluation.model_copy(
        update={
            "episodes": len(won), "seed": 0, "success_rate": rate, "mean_return": float(returns.mean()),
            "std_return": float(returns.std(ddof=1)), "mean_steps": float(steps.mean()),
            "std_steps": float(steps.std(ddof=1)),
        }
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.5, 0.9, 0.99])
def test_honest_agents_are_rarely_called_dishonest_on_other_episodes(rate, sized):
    """Also with returns and steps that are bimodal: a failure costs much, and lasts long."""
    rng, card = np.random.default_rng(0), read_card(card_path("reach_ppo"))

    def evaluation(seed):
        won = rng.random(200) < rate
        steps = np.where(won, rng.integers(8, 20, 200), 75)
        return claims(won, np.where(won, 90.0, 0.0) - steps, steps).model_copy(update={"seed": seed})

    refused = [not Reproduction(card, evaluation(0), evaluation(1)).agrees for _ in range(sized(100, 200))]
    assert np.mean(refused) <= 0.07


def test_each_figure_is_tested_on_other_episodes():
    rng, card = np.random.default_rng(0), read_card(card_path("reach_ppo"))
    won, steps = np.arange(200) < 190, rng.integers(8, 20, 200)
    found = claims(won, 90.0 * won - steps, steps).model_copy(update={"seed": 1})
    for changed, figure in (
        ({"success_rate": 0.8}, "success_rate"),
        ({"mean_return": 95.0}, "mean_return"),
        ({"mean_steps": 1.0}, "mean_steps"),
    ):
        claimed = found.model_copy(update={"seed": 0} | changed)
        (difference,) = Reproduction(card, claimed, found).differences
        assert difference.figure == figure
        assert difference.p < 0.05


def test_where_the_environment_ignores_its_seed_the_episodes_are_other_ones():
    rng, card = np.random.default_rng(0), read_card(card_path("reach_ppo"))
    won, steps = np.arange(200) < 190, rng.integers(8, 20, 200)
    claimed = claims(won, 90.0 * won - steps, steps)
    measured = claims(won, 90.0 * won - steps[::-1] - 0.01, steps)
    assert not Reproduction(card, claimed, measured).agrees
    assert Reproduction(card, claimed, measured, obeys_seed=False).agrees
    (difference,) = Reproduction(card, claimed.model_copy(update={"success_rate": 0.8}), measured, False).differences
    assert difference.p == pytest.approx(3 * unconditional(160, 200, 190, 200))

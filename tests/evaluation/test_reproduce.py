import json
import shutil

import numpy as np
import pytest
from scipy.stats import binomtest
from typer.testing import CliRunner

from armctl.agents import read_card
from armctl.cli import app
from armctl.errors import AgentFileError, ConfigurationError
from armctl.evaluation.reproduce import Reproduction, card_path, reproduce


@pytest.fixture
def agent(tmp_path):
    """A copy of the shipped agent whose card claims what it does in 30 episodes."""
    for suffix in (".json", ".onnx"):
        shutil.copy(card_path("reach_ppo").with_suffix(suffix), tmp_path / f"agent{suffix}")
    path = tmp_path / "agent.json"
    edit(path, episodes=30, success_rate=1.0, success_interval=(0.886, 1.0))
    return path


def edit(path, **changes):
    card = json.loads(path.read_text())
    card["evaluation"] = None if "nothing" in changes else card["evaluation"] | changes
    path.write_text(json.dumps(card))


def test_a_shipped_agent_does_as_its_card_says(agent):
    again = reproduce(agent)
    assert again.agrees
    assert again.found.episodes == 30
    assert again.found.seed == read_card(agent).evaluation.seed
    assert reproduce(agent.with_suffix(".onnx")).found == again.found
    other = reproduce(agent, seed=77)
    assert other.found.seed == 77
    assert other.found.mean_steps_to_goal != again.found.mean_steps_to_goal


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


@pytest.mark.parametrize("card", sorted(card_path("reach_ppo").parent.glob("*.json")), ids=lambda card: card.stem)
def test_every_shipped_agent_does_about_what_its_card_says(card, tmp_path, sized):
    """On some of the episodes: `armctl reproduce` plays all."""
    n = sized(4, 40) if "bridge" in card.stem else sized(12, 100)
    for suffix in (".json", ".onnx"):
        shutil.copy(card.with_suffix(suffix), tmp_path / f"agent{suffix}")
    edit(tmp_path / "agent.json", episodes=n)
    found = reproduce(tmp_path / "agent.json").found
    claimed = read_card(card).evaluation
    assert binomtest(round(n * found.success_rate), n, claimed.success_rate).pvalue > 1e-3


@pytest.mark.parametrize("rate", [0.5, 0.9, 0.99])
def test_honest_agents_are_rarely_called_dishonest(rate):
    rng = np.random.default_rng(0)
    card = read_card(card_path("reach_ppo"))
    claimed, found = rng.binomial(200, rate, size=(2, 500)) / 200

    def said(success_rate):
        return card.evaluation.model_copy(update={"episodes": 200, "success_rate": success_rate})

    refused = [not Reproduction(card, said(a), said(b)).agrees for a, b in zip(claimed, found, strict=True)]
    assert np.mean(refused) <= 0.05
    assert not Reproduction(card, said(0.95), said(0.8)).agrees

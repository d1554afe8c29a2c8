"""The model card says what the agent's own card does, and a hub can read its metadata."""

import json
from typing import Any

import pytest
from huggingface_hub import ModelCard

from armctl.agents import AgentCard, read_card
from armctl.core.seeds import TEST_SEED
from armctl.integrations.hub import model_card
from armctl.policies import agent_cards
from armctl.policies.trainings import card_path

NAME = "owner/agent"


@pytest.fixture
def card():
    return read_card(card_path("reach_ppo"))


@pytest.mark.parametrize("name", sorted(agent_cards()))
def test_all_numbers_are_those_of_the_agents_card(name):
    card = read_card(card_path(name))
    text, found = model_card(card, NAME), card.evaluation
    low, high = found.success_interval
    assert f"**{100 * found.success_rate:.1f} % [{100 * low:.1f}, {100 * high:.1f}]**" in text
    assert f"of {found.episodes:,} held-out episodes, seed {found.seed}" in text
    assert f"return {found.mean_return:g}" in text
    for value in (card.env, card.learner, card.recipe, card.sha256, str(card.cost), card.sees):
        assert value in text
    for name, version in card.versions.items():
        assert f"{name} {version}" in text
    assert f"- Seed: {card.training_seed}\n" in text


def test_a_hub_reads_the_metadata(card):
    data: Any = ModelCard(model_card(card, NAME, "mit")).data
    assert (data.library_name, data.license, data.model_name) == ("armctl", "mit", "reach_ppo")
    assert {"reinforcement-learning", "robotics", "onnx", "armctl/ArmReach-v0"} <= set(data.tags)
    success, reward = data.eval_results
    assert (success.metric_type, success.metric_value) == ("success_rate", card.evaluation.success_rate)
    assert (reward.metric_type, reward.metric_value) == ("mean_reward", card.evaluation.mean_return)
    assert success.dataset_args == {"episodes": 1000, "seed": TEST_SEED}
    assert success.dataset_name == card.env


def test_it_says_how_to_use_it_and_that_there_is_no_code(card):
    text = model_card(card, NAME)
    assert f"armctl pull {NAME}\narmctl compare reach_ik agents/{NAME}/agent.json --env armctl/ArmReach-v0\n" in text
    assert "`agent.onnx` is data: numbers, and standard operators without loops, functions or code." in text
    assert "None is stated" in text
    assert ModelCard(text).data.get("license") is None


def test_an_agent_that_nobody_evaluated(card):
    text = model_card(card.model_copy(update={"evaluation": None}), NAME)
    assert "It has not been evaluated." in text
    assert ModelCard(text).data.get("eval_results") is None


HOSTILE = ["`` ` [link](evil)", "a\n---\nlicense: mine\n---\n# b", "\x1b[2J\x00", "{metadata}", "'\"\\", "é \u202e x"]


@pytest.mark.parametrize("text", HOSTILE)
def test_what_a_card_says_stays_where_it_is(card, text):
    """It breaks neither the metadata nor out of its line."""
    values = json.loads(card.model_dump_json())
    options = {"robot": text, text: 1}
    changed = AgentCard.model_validate(values | {"name": text, "env": text, "teacher": text, "env_options": options})
    made, plain = model_card(changed, NAME), model_card(card, NAME)
    data: Any = ModelCard(made).data
    assert (data.license, data.model_name) == (None, text)
    assert data.eval_results[0].dataset_name == text
    headings = [line for line in made.split("---\n", 2)[2].splitlines() if line.startswith("#")]
    assert headings[1:] == [line for line in plain.splitlines() if line.startswith("## ")]
    assert "\x1b" not in made

import numpy as np
import pytest

from armctl.agents import load_agent
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.policies import make_policy
from armctl.rl.algorithms import finetuned_ppo
from armctl.training.learners import Recipe

SMALL = {
    "worlds": 4, "steps": 64, "critic_steps": 32, "rollout_length": 8, "batch_size": 16, "evaluation_every": 64,
    "validation_episodes": 2, "evaluation_episodes": 2, "keeps": "last",
}  # fmt: skip
SHORT = {"max_episode_steps": 6}


def recipe(**changes):
    options = SMALL | changes.pop("options", {})
    chosen = Recipe(name="tuned", learner="finetuned_ppo", env="armctl/ArmReach-v0", env_options=SHORT, options=options)
    return chosen.changed(**{"teacher": "reach_bc"} | changes)


@pytest.mark.slow
@pytest.mark.parametrize("learns", [False, True])
def test_ppo_starts_from_what_the_agent_does_and_changes_all_of_it(learns, tmp_path, monkeypatch):
    if not learns:
        monkeypatch.setattr(finetuned_ppo.AnchoredPpo, "train", lambda model: None)
    card = finetuned_ppo.train(recipe(), out=tmp_path / "run", seed=0, progress=False)
    assert [ancestor.name for ancestor in card.lineage or []][:1] == ["reach_bc"]
    env = make_worlds("armctl/ArmReach-v0", 3, SHORT)
    observations, _ = env.reset(seed=3)
    agent = load_agent(tmp_path / "run" / "agent.json", env)
    difference = np.abs(agent.act(observations) - make_policy("reach_bc", env).act(observations)).max()
    assert difference < 1e-5 if not learns else 1e-5 < difference < 0.5


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"teacher": None}, "finetuned_ppo starts from an agent: name it"),
        ({"teacher": "reach_ik"}, "without a memory, as bc trains it, and reach_ik is none"),
        ({"options": {"frames": 2}}, "leave the option frames out"),
        ({"options": {"hidden_units": 16}}, "trained with hidden_units 256: set that option, not 16"),
    ],
)
def test_what_it_cannot_start_from_is_refused_before_a_folder_is_made(changes, message, tmp_path):
    with pytest.raises(ConfigurationError, match=message):
        finetuned_ppo.train(recipe(**changes), out=tmp_path / "run", seed=0, progress=False)
    assert not (tmp_path / "run").exists()

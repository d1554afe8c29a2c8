"""Trainings behind the safety filter: exploration touches nothing, and what is learned from is right."""

import json
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3.common.torch_layers import FlattenExtractor

from armctl.agents import load_agent, read_card
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.policies import make_policy
from armctl.policies.filtered import Filtered, FilteredWorlds
from armctl.policies.trainings import card_of
from armctl.rl.networks.view import ActionScale, View
from armctl.rl.run.meter import Meter, Metered
from armctl.rl.run.vector import StableBaselinesVectorEnv
from armctl.study.curves import read_curve
from armctl.training.learners import load_learner, load_recipe

REACH = "armctl/ArmReach-v0"
TINY = {
    "worlds": 32, "steps": 2000, "rollout_length": 32, "batch_size": 512, "epochs": 1, "hidden_units": 8, "frames": 1,
    "initial_log_std": 0.5, "validation_episodes": 2, "evaluation_episodes": 2, "evaluation_every": 10**6,
}  # fmt: skip


def trained(out, *, filter):
    recipe = load_recipe("reach_ppo").changed(options=TINY, filter=filter, env_options={"max_episode_steps": 40})
    return load_learner("ppo")(recipe, out=out, seed=0, progress=False)


@pytest.mark.slow
def test_a_training_behind_the_filter_touches_nothing_and_its_agent_acts_behind_it(tmp_path):
    safe, plain = trained(tmp_path / "safe", filter={"margin": 0.004}), trained(tmp_path / "plain", filter=False)
    assert (safe.contacts, plain.interventions) == (0, None)
    assert safe.interventions > 100 < plain.contacts
    assert read_curve(tmp_path / "safe" / "curve.csv").iloc[-1].interventions == safe.interventions
    path = tmp_path / "safe" / "agent.json"
    assert json.loads(path.read_text())["filter"] == {"margin": 0.004} == read_card(path).filter
    worlds = make_worlds(REACH, 2)
    policy: Any = make_policy(path, worlds)
    assert isinstance(policy, Filtered)
    assert policy.sees == "state" == card_of(path).sees
    assert not isinstance(make_policy(load_agent(path, worlds), worlds), Filtered), "without a name, it acts alone"


def test_what_was_executed_is_what_a_replay_buffer_gets(tmp_path):
    """A changed action in the network's units, seen from the observation that it answered, is the executed command."""
    worlds = make_worlds(REACH, 8, autoreset_mode="same_step")
    meter = Meter(tmp_path / "clock.json", resumed=False)
    metered = Metered(FilteredWorlds(worlds), meter)
    scale = ActionScale(*(np.full(6, bound) for bound in (-3.0, 3.0)), relative_to=slice(3, 9))
    adapter = StableBaselinesVectorEnv(metered, View(scale, FlattenExtractor))
    adapter.seed(0)
    observed, rng, changed = adapter.reset(), np.random.default_rng(0), 0
    for _ in range(12):
        proposed = rng.uniform(-1, 1, (8, 6)).astype(np.float32)
        after, *_ = adapter.step(proposed)
        stored, (commands, mask) = adapter.executed(proposed), metered.executed
        np.testing.assert_array_equal(stored[~mask], proposed[~mask])
        again = scale(torch.as_tensor(observed), torch.as_tensor(stored)).numpy()
        np.testing.assert_allclose(again, commands, atol=1e-5)
        observed, changed = after.copy(), changed + mask.sum()
    assert meter.read()["interventions"] == changed > 0


@pytest.mark.parametrize(
    ("recipe", "message"),
    [("reach_dagger", "takes no filter"), ("bridge_state_ppo", "physics"), ("reach_ppo", "margin")],
)
def test_trainings_that_cannot_be_filtered(recipe, message, tmp_path):
    filtered = load_recipe(recipe).changed(filter={"margn": 1} if recipe == "reach_ppo" else True)
    with pytest.raises(ConfigurationError, match=message):
        load_learner(filtered.learner)(filtered, out=tmp_path / "run", seed=0, progress=False)
    assert not (tmp_path / "run").exists()

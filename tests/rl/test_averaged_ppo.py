import numpy as np
import pytest
import torch

from armctl.agents import load_agent
from armctl.envs import make_worlds
from armctl.errors import ConfigurationError
from armctl.learners import load_recipe
from armctl.rl import cloned_ppo, ppo
from armctl.rl.averaged_ppo import AveragedPpo

SMALL = {
    "steps": 96, "worlds": 4, "rollout_length": 8, "batch_size": 16, "hidden_units": 8, "layers": 1,
    "evaluation_every": 32, "validation_episodes": 2, "evaluation_episodes": 2, "averaging": 0.75,
}  # fmt: skip


def recipe(**options):
    return load_recipe("reach_ppo").changed(env_options={"max_episode_steps": 5}, options=SMALL | options)


def weights(policy):
    return torch.cat([values.flatten() for values in policy.parameters()]).detach().clone()


def test_the_agent_is_the_average_of_the_policies_after_each_update(tmp_path, monkeypatch):
    policies, averages, update = [], [], ppo.PPO.train

    def noted(model):
        if not policies:
            policies.append(weights(model.policy))
        averages.append(weights(model.average))
        update(model)
        policies.append(weights(model.policy))

    monkeypatch.setattr(ppo.PPO, "train", noted)
    ppo.train(recipe(), out=tmp_path / "run", seed=0, progress=False)
    model = AveragedPpo.load(tmp_path / "run" / "checkpoints" / "96.zip", device="cpu")
    expected = policies[0]
    for average, policy in zip([*averages, weights(model.average)], [*policies[1:], None], strict=True):
        torch.testing.assert_close(average, expected)
        if policy is not None:
            expected = 0.75 * expected + 0.25 * policy
    assert not torch.allclose(weights(model.average), weights(model.policy))
    assert not any(parameter.requires_grad for parameter in model.average.parameters())


def test_the_exported_graph_acts_as_the_average(tmp_path):
    card = ppo.train(recipe(), out=tmp_path / "run", seed=0, progress=False)
    model = AveragedPpo.load(tmp_path / "run" / "checkpoints" / f"{card.best_after}.zip", device="cpu")
    worlds = make_worlds("armctl/ArmReach-v0", 20)
    observations, _ = worlds.reset(seed=0)
    with torch.no_grad():
        raw = ppo.MeanAction(model.average)(torch.as_tensor(observations)).numpy()
    expected = observations[:, 3:9] + 0.5 * raw.clip(-1, 1)
    found = load_agent(tmp_path / "run" / "agent.json", worlds).act(observations)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_a_resumed_training_goes_on_averaging(tmp_path):
    for stop in (64, 96):
        ppo.train(recipe(steps=stop), out=tmp_path / "run", seed=0, resume=stop > 64, progress=False)
    before, after = (
        AveragedPpo.load(tmp_path / "run" / "checkpoints" / f"{stop}.zip", device="cpu") for stop in (64, 96)
    )
    torch.testing.assert_close(weights(after.average), 0.75 * weights(before.average) + 0.25 * weights(after.policy))


@pytest.mark.parametrize("share", [-0.1, 1.0])
def test_shares_out_of_range_are_refused(share):
    with pytest.raises(ConfigurationError, match="averaging"):
        recipe(averaging=share).read_options(ppo.PpoOptions)


def test_a_clone_is_not_averaged(tmp_path):
    chosen = load_recipe("reach_cloned_ppo").changed(options={"averaging": 0.5})
    with pytest.raises(ConfigurationError, match="leave the option averaging out"):
        cloned_ppo.train(chosen, out=tmp_path / "run", seed=0)

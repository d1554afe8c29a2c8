"""Models of Stable-Baselines3 with random weights, environments to export them for, and comparisons of both."""

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from armctl.agents import load_agent, read_card
from armctl.envs import make_worlds
from tests.command_line import armctl

SMALL = {"buffer_size": 100}
LSTM = {"lstm_hidden_size": 16}

IMAGE = spaces.Box(0, 255, (36, 36, 3), np.uint8)
VECTOR = spaces.Box(-np.inf, np.inf, (3,), np.float32)
PUSH = spaces.Box(np.array([-1.0, 0.0], np.float32), np.array([1.0, 5.0], np.float32))
PARTS = spaces.Dict({"speed": VECTOR, "grip": spaces.Discrete(3), "image": IMAGE})


class Anything(gymnasium.Env):
    """Random observations of any space; episodes of ten steps."""

    metadata = {"render_modes": ["rgb_array"]}

    def __init__(self, observed, commanded, render_mode=None):
        self.observation_space, self.action_space, self.render_mode = observed, commanded, render_mode

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        if seed is not None:
            self.observation_space.seed(seed)
        self.steps = 0
        return self.observation_space.sample(), {}

    def step(self, action):
        self.steps += 1
        return self.observation_space.sample(), 0.0, False, self.steps == 10, {}


OBSERVED = {
    "image": IMAGE,
    "parts": PARTS,
    "number": spaces.Discrete(5),
    "numbers": spaces.MultiDiscrete([3, 4]),
    "bits": spaces.MultiBinary(4),
    "double": spaces.Box(-np.inf, np.inf, (3,), np.float64),
    "vector": VECTOR,
    "two": spaces.Dict({"speed": VECTOR, "place": spaces.Box(-50, 50, (2,), np.float32)}),
}
COMMANDED = {
    "push": PUSH,
    "choice": spaces.Discrete(3),
    "choices": spaces.MultiDiscrete([2, 3]),
    "switches": spaces.MultiBinary(3),
    "table": spaces.Box(-9.0, 4.0, (2, 2), np.float32),
    "exact": spaces.Box(-2.0, 3.0, (2,), np.float64),
}


def register():
    """Make `sb3/OBSERVED-COMMANDED-v0` an environment for each pair."""
    for seen, observed in OBSERVED.items():
        for done, commanded in COMMANDED.items():
            env, spaces = f"sb3/{seen}-{done}-v0", {"observed": observed, "commanded": commanded}
            if env not in gymnasium.registry:
                gymnasium.register(env, Anything, kwargs=spaces)  # type: ignore[arg-type] # a class makes one too


def make(kind, env, policy="MlpPolicy", **options):
    """A model of an algorithm, whose random weights are large enough for its actions to differ."""
    model = kind(policy, env, seed=0, device="cpu", **options)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for name, parameter in model.policy.named_parameters():
            if "bias" in name:
                parameter.zero_()
            elif parameter.ndim > 1:
                parameter.copy_(torch.randn(parameter.shape, generator=generator) * 1.5 / parameter[0].numel() ** 0.5)
    return model


def normalised(env, folder, name="vecnormalize.pkl", **options):
    """Statistics of an environment, saved, and as `predict` is used with them."""
    venv = VecNormalize(DummyVecEnv([lambda: gymnasium.make(env)]), **options)
    venv.seed(0)
    venv.reset()
    for _ in range(50):
        venv.step(np.array([venv.action_space.sample()]))
    venv.save(str(folder / name))
    return venv


def exported(model, env, folder, *arguments):
    """The card and the agent, loaded for n worlds, of a model that the command line has exported."""
    model.save(folder / "model.zip")
    said = armctl("export", "model.zip", "--env", env, "--out", "agent.onnx", "--trust", *arguments, cwd=folder).stdout
    assert "act alike on 1,000 observations" in said
    card = read_card(folder / "agent.json")
    return card, lambda n: load_agent(folder / "agent.onnx", make_worlds(env, n))


def observations(env, steps, n, seed=5):
    """Observations (steps, n) of random actions, and where episodes begin (steps, n)."""
    worlds = make_worlds(env, n)
    worlds.single_action_space.seed(seed)
    seen, _ = worlds.reset(seed=seed)
    began, shown = [np.ones(n, dtype=bool)], [seen]
    for _ in range(steps - 1):
        actions = np.array([worlds.single_action_space.sample() for _ in range(n)])
        seen, _, terminated, truncated, _ = worlds.step(actions)
        over = terminated | truncated
        if over.any():
            seen, _ = worlds.reset(options={"reset_mask": over})
        shown.append(seen)
        began.append(over)
    return shown, began


def check_acts_alike(model, agent, env, normalise=lambda seen: seen, steps=250, n=4):
    shown, began = observations(env, steps, n)
    state, predicted, acted = None, [], []
    for seen, starts in zip(shown, began, strict=True):
        agent.reset(np.flatnonzero(starts).astype(np.int32))
        action, state = model.predict(normalise(seen), state, starts, deterministic=True)
        predicted.append(action)
        acted.append(agent.act(seen))
    wanted, found = np.array(predicted), np.array(acted)
    assert wanted.shape[:2] == (steps, n)
    assert len(np.unique(wanted.reshape(steps * n, -1), axis=0)) > 1, "the actions differ"
    np.testing.assert_allclose(found, wanted, atol=1e-5, rtol=1e-5)

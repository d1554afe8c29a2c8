"""armctl's vector environments as its own learners see them."""

from typing import Any, ClassVar

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray

from armctl.envs import one_of
from armctl.envs.observations import stacked
from armctl.integrations.sb3 import VecEnv
from armctl.policies import Policy
from armctl.rl.networks.actor import Actor, numpy_arrays, tensors
from armctl.rl.networks.encoder import Encoded, Encoder
from armctl.rl.networks.frames import FeatureHistory, History
from armctl.rl.networks.onnx_graph import initial_memory
from armctl.rl.networks.view import View
from armctl.rl.run.meter import Metered
from armctl.rl.run.options import FrameOptions
from armctl.rl.run.training import Training


class StableBaselinesVectorEnv(VecEnv):
    """Actions in [-1, 1], which a view's `action_scale` turns into the environment's."""

    def __init__(self, env: Metered, view: View) -> None:
        super().__init__(env)
        self.action_space = gymnasium.spaces.Box(-1, 1, env.single_action_space.shape)
        self.view = view
        self._action_scale: Any = view.action_scale

    @property
    def policy_class(self) -> Any:
        """Stable-Baselines3's policy, or its name, for what the worlds show: one array, or several by name."""
        return "MultiInputPolicy" if isinstance(self.observation_space, gymnasium.spaces.Dict) else "MlpPolicy"

    @property
    def policy_kwargs(self) -> dict[str, Any]:
        """Arguments of that policy for the features of what the worlds show."""
        return {"features_extractor_class": self.view.features, "features_extractor_kwargs": self.view.features_options}

    def actor(self, network: torch.nn.Module, training: Training) -> Actor:
        """Return an actor for a training's held-out worlds, with a network of what these worlds show."""
        space, memory = training.held_out.single_observation_space, getattr(network, "memory", None)
        return Actor(network, training.view.action_scale, space, memory)

    def executed(self, actions: NDArray[Any]) -> Any:
        """Return the last `actions` (n, k), with those that the safety filter put in their place, up to [-1, 1]."""
        if self.env.executed is None:
            return actions
        commands, changed = self.env.executed
        inverse = self._action_scale.inverse(tensors(self._acted_on), torch.as_tensor(commands, dtype=torch.float32))
        return np.where(changed[:, None], inverse.numpy(), actions)

    def actions_of(self, policy: Policy) -> NDArray[Any]:
        """Return the actions (n, k) in [-1, 1] of a policy of the environment's for the present observations."""
        commands = torch.as_tensor(np.asarray(policy.act(self._observations)), dtype=torch.float32)
        return self._action_scale.inverse(tensors(self._observations), commands).numpy()

    def _commands(self, actions: NDArray[Any]) -> Any:
        self._acted_on = self._observations
        return self._action_scale(tensors(self._observations), torch.as_tensor(actions)).numpy()


class EncodedVectorEnv(StableBaselinesVectorEnv):
    """Worlds that show what an encoder makes of their observations."""

    takes_features: ClassVar[bool] = True
    """True if an encoder may give features in place of what they are made of."""

    def __init__(self, encoder: Encoder, *args: Any) -> None:
        super().__init__(*args)
        self.encoder, self.observation_space = encoder, encoder.space
        self._memory = initial_memory(encoder.memory, self.num_envs)

    def reset(self) -> Any:
        """Start new episodes in all worlds."""
        self._memory = initial_memory(self.encoder.memory, self.num_envs)
        return self._encoded(super().reset())

    def step_wait(self) -> Any:
        """Step all worlds."""
        observations, rewards, done, infos = super().step_wait()
        if (done_ids := np.flatnonzero(done)).size:
            last = stacked([infos[i]["terminal_observation"] for i in done_ids])
            with torch.no_grad():
                final = numpy_arrays(self.encoder(tensors(last), *(part[done_ids] for part in self._memory))[0])
            for k, i in enumerate(done_ids):
                infos[i]["terminal_observation"] = one_of(final, k)
            # in place, it would change the stacks that the learner has been shown, which share their memory
            self._memory = [part.index_fill(0, torch.as_tensor(done_ids), 0.0) for part in self._memory]
        return self._encoded(observations), rewards, done, infos

    @property
    def policy_kwargs(self) -> dict[str, Any]:
        """Arguments of a policy for the features of encoded observations."""
        return self.encoder.features(self.view)

    def actor(self, network: torch.nn.Module, training: Training) -> Actor:
        """Return an actor for a training's held-out worlds, with a network of encoded observations."""
        encoder = self.encoder.rebuilt_for(training.view, training.held_out.single_observation_space)
        return super().actor(Encoded(encoder, network), training)

    def _encoded(self, observations: Any) -> Any:
        with torch.no_grad():
            encoded, *self._memory = self.encoder(tensors(observations), *self._memory)
        return numpy_arrays(encoded)


def vec_env_of(
    envs: Any, view: View, options: FrameOptions, kind: type[EncodedVectorEnv] = EncodedVectorEnv
) -> StableBaselinesVectorEnv:
    """Return worlds as a learner with these options sees them: of a `kind`, or without encoder if none is needed."""
    space = envs.single_observation_space
    shows_features = kind.takes_features and view.has_fixed_features(space)
    if kind is EncodedVectorEnv and options.frames == 1 and view.prepare is None and not shows_features:
        return StableBaselinesVectorEnv(envs, view)
    encoder = (FeatureHistory if shows_features else History)(view, space, options.frames, options.frame_gap)
    return kind(encoder, envs, view)

"""An asymmetric critic (Pinto et al., Asymmetric actor critic for image-based robot learning, RSS 2018).

While an agent learns, its critic sees the state, and its actor the environment's observation. The agent that comes of
it is the actor.
"""

from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy, MultiInputActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, MlpExtractor

from armctl.agents import INPUT, inputs
from armctl.core.errors import ConfigurationError
from armctl.rl.networks.onnx_graph import observation_of
from armctl.rl.run.vector import EncodedVectorEnv

STATE = "privileged_state"
"""Name of the state beside the observation's arrays."""


class AsymmetricVectorEnv(EncodedVectorEnv):
    """Worlds that show the state's features beside the observation: the view's, or its numbers as shares of bounds.

    They are without weights, so that they are computed once. Raises `ConfigurationError` for features with weights, and
    for tasks that do not say their state.
    """

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        envs = self.env.unwrapped
        self._task = envs.task
        if self._task.state_space is None:
            raise ConfigurationError(
                f"a privileged critic sees the state, which {type(self._task).__name__} does not say (state_space): "
                "leave privileged_critic out"
            )
        space, features = self._task.state_space, self.view.state_features
        self._features = Shares(space) if features is None else features(space)
        if any(True for _ in self._features.parameters()):
            raise ConfigurationError(f"{type(self._features).__name__}: features of states are without weights")
        self._final = np.zeros((self.num_envs, *space.shape), dtype=np.float32)
        envs.observers.append(self)
        features_space = gymnasium.spaces.Box(-np.inf, np.inf, (self._features.features_dim,), np.float32)
        self.observation_space = gymnasium.spaces.Dict({**inputs(self.encoder.space), STATE: features_space})

    @property
    def policy_class(self) -> Any:
        """Policy of an actor of the observation, and a critic of the state."""
        return AsymmetricPolicy

    def began(self, ids: NDArray[np.int32]) -> None:
        """Do nothing: the states of worlds that have begun an episode are read when they are shown."""

    def stepped(self, awake: NDArray[np.bool_]) -> None:
        """Keep the states before an autoreset replaces them."""
        self._final = self._task.state_observation()

    def reset(self) -> Any:
        """Start new episodes in all worlds."""
        return _beside(super().reset(), self._features_of(self._task.state_observation()))

    def step_wait(self) -> Any:
        """Step all worlds."""
        observations, rewards, done, infos = super().step_wait()
        ids = np.flatnonzero(done)
        for i, features in zip(ids, self._features_of(self._final[ids]), strict=True):
            infos[i]["terminal_observation"] = _beside(infos[i]["terminal_observation"], features)
        return _beside(observations, self._features_of(self._task.state_observation())), rewards, done, infos

    def _features_of(self, states: NDArray[np.float32]) -> Any:
        with torch.no_grad():
            return self._features(torch.as_tensor(states)).numpy()


class AsymmetricPolicy(MultiInputActorCriticPolicy):
    """An actor of the observation, and a critic of the state beside it."""

    def __init__(
        self, *args: Any, features_extractor_class: Any, features_extractor_kwargs: Any, **kwargs: Any
    ) -> None:
        self._observed = {
            "features_extractor_class": features_extractor_class,
            "features_extractor_kwargs": features_extractor_kwargs,
        }
        super().__init__(
            *args,
            **kwargs,
            features_extractor_class=ObservedFeatures,
            features_extractor_kwargs={"kind": features_extractor_class, "options": features_extractor_kwargs},
            share_features_extractor=False,
        )

    def extract_features(self, obs: Any, features_extractor: BaseFeaturesExtractor | None = None) -> Any:
        """Return features of actor and critic; or those of one extractor. The actor's needs no state beside."""
        if features_extractor is None:
            return super().extract_features(obs)
        return BasePolicy.extract_features(self, obs if isinstance(obs, dict) else {INPUT: obs}, features_extractor)

    def _build_mlp_extractor(self) -> None:
        """Give the critic its own features: they have another size than the actor's."""
        super()._build_mlp_extractor()
        self.vf_features_extractor = StateFeatures(self.observation_space)
        critic = MlpExtractor(self.vf_features_extractor.features_dim, self.net_arch, self.activation_fn, self.device)
        self.mlp_extractor.value_net = critic.value_net

    def _get_constructor_parameters(self) -> dict[str, Any]:
        return {**super()._get_constructor_parameters(), **self._observed}


class ObservedFeatures(BaseFeaturesExtractor):
    """The actor's features, of a `kind` with `options`, of what is shown without the state beside it."""

    def __init__(
        self, observation_space: gymnasium.spaces.Dict, kind: type[BaseFeaturesExtractor], options: Mapping[str, Any]
    ) -> None:
        spaces = {name: space for name, space in observation_space.items() if name != STATE}
        is_single = list(spaces) == [INPUT]
        features = kind(spaces[INPUT] if is_single else gymnasium.spaces.Dict(spaces), **options)
        super().__init__(observation_space, features.features_dim)
        self.features, self.names = features, list(spaces)

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return features (n, k)."""
        return self.features(observation_of(self.names, [observations[name] for name in self.names]))


class StateFeatures(BaseFeaturesExtractor):
    """The state's features, which the worlds show."""

    def __init__(self, observation_space: gymnasium.spaces.Dict) -> None:
        super().__init__(observation_space, observation_space[STATE].shape[0])  # type: ignore[index]

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return features (n, k)."""
        return observations[STATE]


class Shares(BaseFeaturesExtractor):
    """Numbers as shares of their bounds, where these are finite."""

    def __init__(self, observation_space: gymnasium.Space[Any]) -> None:
        high = np.asarray(observation_space.high)  # type: ignore[attr-defined]
        super().__init__(observation_space, high.size)
        self.register_buffer("scale", torch.as_tensor(1 / np.where(np.isfinite(high) & (high > 0), high, 1.0)).float())

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return shares (n, k) of numbers (n, k)."""
        return self.scale * observations


def _beside(observations: Any, features: NDArray[np.float32]) -> dict[str, Any]:
    parts = observations if isinstance(observations, dict) else {INPUT: observations}
    return {**parts, STATE: features}

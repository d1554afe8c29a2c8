import contextlib
from typing import Any

import numpy as np
import pytest

from armctl.baselines.hybrids.cleaned_images import noise_of
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.policies import make_policy
from armctl.rollout import evaluate

ENV = "armctl/BridgeCrossMoving-v0"


@pytest.mark.slow
def test_an_agent_that_noise_blinds_crosses_bridges():
    """`bridge_moving_ppo` by itself crosses none."""
    episodes = evaluate(
        "bridge_cleaned", ENV, episodes=4, seed=300, worlds=4, env_options={"disturbances": {"noise": 0.05}},
        lower_bound_steps=False,
    )  # fmt: skip
    assert episodes.success.sum() >= 3


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.1])
def test_the_noise_of_an_image_is_seen_in_it(noise):
    rng = np.random.default_rng(0)
    with contextlib.closing(make_worlds(ENV, 4)) as worlds:
        observations: Any = worlds.reset(seed=5)[0]
    for image in observations["image"]:
        noisy = image + noise * rng.standard_normal(image.shape)
        assert noise_of(noisy) == pytest.approx(noise, rel=0.3, abs=0.003)


def test_without_noise_the_agent_acts_as_by_itself():
    with contextlib.closing(make_worlds(ENV, 2)) as worlds:
        observations, _ = worlds.reset(seed=5)
        policies = [make_policy(name, worlds) for name in ("bridge_cleaned", "bridge_moving_ppo")]
        for policy in policies:
            policy.reset(np.arange(2, dtype=np.int32))
        for _ in range(4):
            first, second = (policy.act(observations) for policy in policies)
            np.testing.assert_array_equal(first, second)
            observations, *_ = worlds.step(second)


def test_experts_are_refused():
    with (
        contextlib.closing(make_worlds(ENV, 1)) as worlds,
        pytest.raises(ConfigurationError, match="bridge_dwa is none"),
    ):
        make_policy("bridge_cleaned:agent='bridge_dwa'", worlds)

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.policies import make_policy

ENV = "armctl/ArmPush-v0"
NOISY = Path(__file__).parents[2] / "examples" / "noisy_pushes.py"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "policy"), [("ur5", "push_line"), ("ur5", "push_line:memory=false"), ("panda", "push_line")]
)
def test_places_the_object(robot, policy):
    played = armctl.evaluate(
        policy, ENV, episodes=10, worlds=10, seed=301, env_options={"robot": robot}, lower_bound_steps=False
    )
    assert played["success"].sum() >= 9


def test_lifts_the_tool_and_comes_back_when_the_object_has_drifted_off():
    env = make_worlds(ENV, 1, options={})
    observations, _ = env.reset(seed=301)
    policy: Any = make_policy("push_line", env)
    policy.reset(np.zeros(1, dtype=np.int32))
    (expert,), phases = policy.controllers, []
    for step in range(60):
        observations, *_ = env.step(policy.act(observations))
        if step == 40:
            env.task._object_qpos[0, :2] = 0.5, 0.0
            env.task.simulation.refresh()
        if not phases or phases[-1] != expert._phase.value:
            phases.append(expert._phase.value)
    assert phases[:3] == ["over", "down", "push"]
    assert "up" in phases[3:]


def test_without_memory_it_does_the_same_whatever_was_before():
    env = make_worlds(ENV, 2, options={})
    observations, _ = env.reset(seed=302)
    led, fresh = make_policy("push_line:memory=false", env), make_policy("push_line:memory=false", env)
    ids = np.arange(2, dtype=np.int32)
    led.reset(ids)
    for _ in range(20):
        fresh.reset(ids)
        actions = led.act(observations)
        np.testing.assert_array_equal(actions, fresh.act(observations))
        observations, *_ = env.step(actions)


@pytest.mark.parametrize("options", [{"control": "velocity"}, {"observation": "features"}])
def test_refuses_what_it_cannot_play(options):
    with pytest.raises(ConfigurationError, match="push_line"):
        make_policy("push_line", make_worlds(ENV, 1, options))
    with pytest.raises(ConfigurationError, match="ArmPush"):
        make_policy("push_line", make_worlds("armctl/ArmReach-v0", 1, {}))


def test_bad_pushes_have_noise_in_half_of_the_control_steps():
    env = make_worlds(ENV, 4)
    observations, _ = env.reset(seed=302)
    expert, noisy = (make_policy(name, env, policy_seed=0) for name in ("push_line:memory=false", f"{NOISY}:make"))
    for policy in (expert, noisy):
        policy.reset(np.arange(4, dtype=np.int32))
    commands = expert.act(observations)
    noise = np.array([noisy.act(observations) - commands for _ in range(50)]).reshape(200, -1)
    with_noise = noise.any(axis=1)
    assert 80 < with_noise.sum() < 120
    assert 0.045 < noise[with_noise].std() < 0.055

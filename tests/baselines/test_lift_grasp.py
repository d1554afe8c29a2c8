from typing import Any

import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.policies import make_policy

ENV = "armctl/ArmLift-v0"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("policy", "disturbances"), [("lift_grasp", {}), ("lift_grasp", {"noise": 0.01}), ("lift_grasp:memory=false", {})]
)
def test_lifts_the_object(policy, disturbances):
    options = {"disturbances": disturbances}
    played = armctl.evaluate(
        policy, ENV, episodes=10, worlds=10, seed=301, env_options=options, lower_bound_steps=False
    )
    assert played["success"].sum() >= 9


def test_without_memory_it_does_the_same_whatever_was_before():
    env = make_worlds(ENV, 2, options={})
    observations, _ = env.reset(seed=302)
    led, fresh = make_policy("lift_grasp:memory=false", env), make_policy("lift_grasp:memory=false", env)
    ids = np.arange(2, dtype=np.int32)
    led.reset(ids)
    for _ in range(40):
        fresh.reset(ids)
        actions = led.act(observations)
        np.testing.assert_array_equal(actions, fresh.act(observations))
        observations, *_ = env.step(actions)


def test_begins_again_when_the_object_has_not_followed():
    env = make_worlds(ENV, 1, options={})
    observations, _ = env.reset(seed=301)
    policy: Any = make_policy("lift_grasp", env)
    policy.reset(np.zeros(1, dtype=np.int32))
    (expert,), phases = policy.controllers, []
    for _ in range(90):
        observations, *_ = env.step(policy.act(observations))
        if not phases or phases[-1] != expert._phase.value:
            phases.append(expert._phase.value)
            if phases == ["over", "down", "close"]:
                env.task._object_qpos[0, 0] -= 0.12
                env.task.simulation.refresh()
    assert phases[:5] == ["over", "down", "close", "lift", "over"]


@pytest.mark.parametrize("options", [{"control": "velocity"}, {"observation": "features"}])
def test_refuses_what_it_cannot_play(options):
    with pytest.raises(ConfigurationError, match="lift_grasp"):
        make_policy("lift_grasp", make_worlds(ENV, 1, options))
    with pytest.raises(ConfigurationError, match="ArmLift"):
        make_policy("lift_grasp", make_worlds("armctl/ArmReach-v0", 1, {}))

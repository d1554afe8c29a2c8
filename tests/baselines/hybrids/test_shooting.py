from typing import Any

import numpy as np
import pytest

from armctl.baselines.hybrids.shooting import ShootingOptions, ShootingPolicy
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.policies import make_policy, sees

ENV = "armctl/ArmReachObstacles-v0"


class Stuck:
    """An agent that stays where it is, and counts how often it was asked."""

    training_steps, training_cost, card, sees = 0, None, None, "model"

    def __init__(self):
        self.asked = 0

    def reset(self, ids):
        pass

    def act(self, observations):
        self.asked += len(observations)
        return np.asarray(observations[:, 3:9], dtype=np.float32)


def make(agent, worlds, **options):
    made = []

    @sees("model")
    def factory(env):
        made.append(ShootingPolicy(agent, env, ShootingOptions(**options)))
        return made[-1]

    make_policy(factory, worlds)
    return made[0]


def play(policy, worlds, seed, steps=60):
    """The actions (steps, n, 6) and outcomes of the first episodes of a seed."""
    observations, _ = worlds.reset(seed=seed)
    policy.reset(np.arange(worlds.num_envs, dtype=np.int32))
    actions, won, over = [], np.zeros(worlds.num_envs, bool), np.zeros(worlds.num_envs, bool)
    for _ in range(steps):
        actions.append(policy.act(observations))
        observations, _, terminated, _, _ = worlds.step(actions[-1].astype(np.float32))
        won |= ~over & (worlds.task.outcome() == 1)
        over |= terminated
        if over.all():
            break
    return np.array(actions), won


@pytest.fixture
def worlds():
    made = make_worlds(ENV, 6, {})
    yield made
    made.close()


@pytest.mark.slow
def test_it_wins_more_than_the_clone_by_itself(worlds, sized):
    seeds = range(sized(2, 5))
    wins = dict.fromkeys(("obstacles_imagined", "obstacles_plan_bc"), 0)
    for name in wins:
        for seed in seeds:
            wins[name] += play(make_policy(name, worlds), worlds, seed)[1].sum()
    assert wins["obstacles_imagined"] >= 0.9 * 6 * len(seeds)
    assert wins["obstacles_imagined"] > wins["obstacles_plan_bc"]


def test_a_world_s_commands_do_not_depend_on_the_others():
    together, alone = make_worlds(ENV, 4, {}), make_worlds(ENV, 1, {})
    first, _ = play(make_policy("obstacles_imagined", together), together, 0, steps=8)
    seed = int(together.seeds[0])
    again, _ = play(make_policy("obstacles_imagined", alone), alone, seed, steps=8)
    length = min(len(first), len(again))
    np.testing.assert_array_equal(again[:length, 0], first[:length, 0])
    together.close()
    alone.close()


def test_an_agent_that_never_arrives_acts_by_itself_and_says_so(worlds):
    agent = Stuck()
    policy = make(agent, worlds, copies=2, rounds=2, steps=4, noise=0.0, patience=3)
    observations, _ = worlds.reset(seed=0)
    policy.reset(np.arange(6, dtype=np.int32))
    asked = []
    for _ in range(4):
        np.testing.assert_allclose(policy.act(observations), observations[:, 3:9])
        asked.append(agent.asked)
    imagined = 6 * 2 * 2 * 4
    assert np.diff([0, *asked]).tolist() == [imagined + 6, 6, 6, imagined + 6]
    assert policy.failures.tolist() == [2] * 6
    assert policy.plans(0) == {}


def test_an_arm_that_is_pushed_gets_a_new_plan(worlds):
    policy: Any = make_policy("obstacles_imagined", worlds)
    observations, _ = worlds.reset(seed=0)
    policy.reset(np.arange(6, dtype=np.int32))
    policy.act(observations)
    before = policy._plans.copy()
    pushed = observations.copy()
    pushed[2, 3] += 0.2
    policy.act(pushed)
    changed = (policy._plans != before).any(axis=(1, 2))
    assert changed[2]
    assert changed.sum() == 1


def test_plans_end_at_the_target(worlds):
    policy: Any = make_policy("obstacles_imagined", worlds)
    observations, _ = worlds.reset(seed=0)
    policy.reset(np.arange(6, dtype=np.int32))
    policy.act(observations)
    paths = [policy.plans(world)["path"] for world in range(6) if policy.plans(world)]
    assert len(paths) >= 5
    assert all(path.shape[1] == 3 and np.isfinite(path).all() for path in paths)


@pytest.mark.parametrize("options", [{"copies": 0}, {"margin": -0.1}, {"noise": np.nan}])
def test_options_are_checked(options):
    with pytest.raises(ConfigurationError):
        ShootingOptions(**options)


@pytest.mark.parametrize("env", ["armctl/ArmReach-v0", "armctl/BridgeCross-v0"])
def test_it_is_for_its_own_task(env):
    with pytest.raises(Exception, match="obstacles_plan_bc"):
        make_policy("obstacles_imagined", make_worlds(env, 1, {}))

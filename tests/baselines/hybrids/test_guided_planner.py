import itertools

import numpy as np
import pytest

from armctl.baselines.hybrids.guided_planner import GuidedPlanner, GuideOptions, guided
from armctl.core.errors import ArmctlError, ConfigurationError
from armctl.envs import make_worlds
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker
from armctl.planning import ArmPlannerOptions
from armctl.policies import make_policy, sees
from armctl.scene import Boxes
from armctl.tasks.reach.obstacle_layout import MAX_OBSTACLES

ENV = "armctl/ArmReachObstacles-v0"
POST = Boxes(np.array([[0.4, 0.35, 0.3]]), np.array([[0.05, 0.05, 0.3]]), np.zeros(1))
CLEARANCE = 0.01


class Drifting:
    """An agent that moves joint positions, the numbers 3 to 8 of an observation, towards some."""

    def __init__(self, end):
        self.end = end

    def act(self, observations):
        q = observations[:, 3:9]
        return q + np.clip(self.end - q, -0.2, 0.2)


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


@pytest.fixture(scope="module")
def model():
    return ArmModel("ur5")


def search(model, agent, goals, seed=1, **options):
    edges = EdgeChecker(ArmShapes(model), POST, CLEARANCE, model.home)
    observed = np.zeros(3), np.zeros(7 * MAX_OBSTACLES)
    planner = GuidedPlanner(agent, GuideOptions(**options), *observed, model, ArmPlannerOptions(seed=seed))
    return edges, planner._search(edges, model.home, goals)


def ends(model, rng, count):
    """Free configurations behind the post, to which no straight motion from home is free."""
    edges = EdgeChecker(ArmShapes(model), POST, CLEARANCE, model.home)
    found = []
    while len(found) < count:
        q = model.home + rng.uniform(-1.2, 1.2, 6)
        if edges.is_free(q) and not edges.is_edge_free(model.home, q):
            found.append(q)
    return np.array(found)


def test_paths_are_free_and_end_in_a_goal(model):
    found = 0
    for seed, goal in enumerate(ends(model, np.random.default_rng(0), 6), 1):
        edges, path = search(model, Drifting(goal), goal[None], seed=seed)
        if len(path):
            found += 1
            np.testing.assert_array_equal(path[[0, -1]], [model.home, goal])
            assert model.within_limits(path).all()
            assert all(edges.is_edge_free(a, b) for a, b in itertools.pairwise(path))
    assert found == 6


def test_the_same_seed_gives_the_same_path(model):
    goal = ends(model, np.random.default_rng(1), 1)
    first, again, other = (search(model, Drifting(goal[0]), goal, seed=seed)[1] for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert len(first) != len(other) or (first != other).any()


def test_an_agent_that_stays_where_it_is_finds_nothing_without_noise(model):
    goal = ends(model, np.random.default_rng(2), 1)
    assert search(model, Drifting(model.home), goal, noise=0.0, rounds=2, steps=3)[1].shape == (0, 6)


@pytest.mark.slow
def test_it_wins_more_than_the_clone_by_itself(sized):
    worlds = make_worlds(ENV, 6, {})
    seeds = range(sized(2, 5))
    wins = dict.fromkeys(("obstacles_imagined", "obstacles_plan_bc"), 0)
    for name in wins:
        for seed in seeds:
            wins[name] += play(make_policy(name, worlds), worlds, seed)[1].sum()
    worlds.close()
    assert wins["obstacles_imagined"] >= 0.9 * 6 * len(seeds)
    assert wins["obstacles_imagined"] > wins["obstacles_plan_bc"]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["obstacles_imagined", "scenes_imagined"])
def test_a_world_s_commands_do_not_depend_on_the_others(name):
    env = ENV if name.startswith("obstacles") else "armctl/ArmScenes-v0"
    together, alone = make_worlds(env, 3, {}), make_worlds(env, 1, {})
    first, _ = play(make_policy(name, together), together, 0, steps=8)
    again, _ = play(make_policy(name, alone), alone, int(together.seeds[0]), steps=8)
    length = min(len(first), len(again))
    np.testing.assert_array_equal(again[:length, 0], first[:length, 0])
    together.close()
    alone.close()


@pytest.mark.parametrize("options", [{"copies": 0}, {"noise": np.nan}, {"largest_move": 0.0}, {"copys": 1}])
def test_options_are_checked(options):
    worlds = make_worlds(ENV, 1, {})

    @sees("model")
    def factory(env):
        return guided("obstacles_imagined", "obstacles_plan_bc", env, options)

    with pytest.raises(ConfigurationError, match=next(iter(options))):
        make_policy(factory, worlds)
    worlds.close()


def test_an_expert_guides_nobody():
    worlds = make_worlds(ENV, 1, {})

    @sees("model")
    def factory(env):
        return guided("mine", "reach_ompl", env, {})

    with pytest.raises(ConfigurationError, match="reach_ompl is none"):
        make_policy(factory, worlds)
    worlds.close()


@pytest.mark.parametrize("env", ["armctl/ArmReach-v0", "armctl/BridgeCross-v0"])
def test_it_is_for_its_own_task(env):
    with pytest.raises(ArmctlError, match="obstacles_plan_bc"):
        make_policy("obstacles_imagined", make_worlds(env, 1, {}))

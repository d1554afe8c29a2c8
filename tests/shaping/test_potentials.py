from typing import Any

import gymnasium
import numpy as np
import pytest

from armctl.envs import TaskVectorEnv
from armctl.kinematics import THOROUGH, MinimumTimeReach
from armctl.policies import make_policy
from armctl.shaping import make_potential, potential_names
from armctl.tasks import ReachTask

from .test_wrappers import PAIRS, make


def test_each_environment_names_its_oracles():
    names = {env: potential_names(make(env, 1)) for env in gymnasium.registry if env.startswith("armctl/")}
    assert names == {
        "armctl/ArmLift-v0": ["distance", "lift"],
        "armctl/ArmPose-v0": ["distance", "ik"],
        "armctl/ArmPush-v0": ["distance", "push"],
        "armctl/ArmReach-v0": ["distance", "ik", "mpc"],
        "armctl/ArmReachMoving-v0": ["distance", "ik", "mpc"],
        "armctl/ArmReachObstacles-v0": ["distance", "ik", "mpc", "ompl"],
        "armctl/ArmScenes-v0": ["distance", "ik"],
        "armctl/BarnCross-v0": ["distance", "ompl", "people"],
        "armctl/BarnCrossMoving-v0": ["distance"],
        "armctl/BridgeCross-v0": ["distance", "ompl", "people"],
        "armctl/BridgeCrossMoving-v0": ["distance", "ompl", "people"],
    }


@pytest.mark.one_case
@pytest.mark.parametrize(("env", "name", "expert"), PAIRS)
def test_a_potential_is_one_function_of_the_state_for_an_episode(env, name, expert):
    """A state has the same potential for who has followed the episode and for who looks at its end only."""
    worlds = make(env)
    follower: Any = make_potential(name, worlds)
    actor = make_policy(expert, worlds)
    observations, _ = worlds.reset(seed=2)
    ids = np.arange(4, dtype=np.int32)
    actor.reset(ids)
    follower.begin(ids)
    for _ in range(6):
        observations, *_ = worlds.step(actor.act(observations))
        follower.potentials(ids)
    now = follower.potentials(ids)
    assert np.isfinite(now).all()
    assert (now <= 0).all()
    late: Any = make_potential(name, worlds)
    if name == "mpc":
        late._chosen = follower._chosen  # chosen at the start of the episode
    else:
        late.begin(ids)
    np.testing.assert_array_equal(late.potentials(ids[::-1]), now[::-1])
    np.testing.assert_array_equal(late.potentials(ids[1:3]), now[1:3])


@pytest.mark.one_case
@pytest.mark.parametrize(("env", "name", "expert"), [pair for pair in PAIRS if "Moving" not in pair[0]])
def test_an_expert_climbs_its_potential(env, name, expert):
    worlds = make(env)
    potential, actor = make_potential(name, worlds), make_policy(expert, worlds)
    observations, _ = worlds.reset(seed=5)
    ids = np.arange(4, dtype=np.int32)
    actor.reset(ids)
    potential.begin(ids)
    begin = highest = potential.potentials(ids)
    won = np.zeros(4, dtype=bool)
    while not won.all():
        observations, _, terminated, truncated, infos = worlds.step(actor.act(observations))
        won |= terminated & infos["is_success"]
        assert not truncated.any()
        highest = np.maximum(highest, potential.potentials(ids))
    # the expert may come into the sphere elsewhere than the potential's own plan
    assert (highest > 0.6 * begin).all()


def test_ik_is_near_the_min_time():
    worlds = TaskVectorEnv(40, task=ReachTask)
    potential = make_potential("ik", worlds)
    worlds.reset(seed=1)
    ids = np.arange(40, dtype=np.int32)
    potential.begin(ids)
    least = np.array([worlds.task.min_time(i) for i in ids])
    over = -potential.potentials(ids) - least
    assert (over > -0.01).all()
    assert np.median(over) < 0.03
    assert np.quantile(over, 0.9) < 0.12


@pytest.mark.slow
def test_ik_is_zero_in_the_sphere_only():
    worlds = TaskVectorEnv(8, task=ReachTask)
    potential, actor = make_potential("ik", worlds), make_policy("reach_ik", worlds)
    observations, _ = worlds.reset(seed=1)
    ids = np.arange(8, dtype=np.int32)
    actor.reset(ids)
    potential.begin(ids)
    for _ in range(40):
        observations, *_ = worlds.step(actor.act(observations))
        inside = worlds.task.state.distance <= 0.05
        np.testing.assert_array_equal(potential.potentials(ids) == 0, inside)


def test_ompl_is_zero_without_a_path():
    worlds = make("armctl/ArmReachObstacles-v0", 2)
    worlds.reset(seed=0)
    worlds.task._boxes[1, 0] = *worlds.task.state.target_position[1], 0.15, 0.15, 0.15, 0.0
    potential: Any = make_potential("ompl", worlds)
    ids = np.arange(2, dtype=np.int32)
    potential.begin(ids)
    potentials = potential.potentials(ids)
    assert potentials[0] < 0
    assert potentials[1] == 0


def test_the_path_of_ompl_ends_in_the_sphere():
    worlds = make("armctl/ArmReachObstacles-v0", 5)
    worlds.reset(seed=0)
    reach = MinimumTimeReach(worlds.task._workspace.model, THOROUGH)
    potential: Any = make_potential("ompl", worlds)
    potential.begin(np.arange(5, dtype=np.int32))
    found = np.flatnonzero(potential._has_path)
    assert len(found) >= 4  # feasible is what another planner, with more time and less clearance, has certified
    for i in found:
        tip = reach.model.position(potential._points[i, -1])
        assert np.linalg.norm(tip - worlds.task.state.target_position[i]) <= worlds.task.options.tolerance

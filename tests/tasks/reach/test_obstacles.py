import gymnasium
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.envs import TaskVectorEnv
from armctl.kinematics import ArmModel
from armctl.planning import ArmPlanner, PathCertificate, PathCertificateOptions
from armctl.scene import BOX_NUMBERS
from armctl.tasks import ReachObstaclesTask
from armctl.tasks.reach import read_boxes
from armctl.tasks.reach.obstacle_layout import MAX_OBSTACLES

ENV = "armctl/ArmReachObstacles-v0"


def hold_still(env):
    return env.task.arm.joint_positions.copy()


def set_arm(task, world, q):
    task.simulation.array("qpos")[world] = q
    task.simulation.array("act")[world] = q
    task.arm.joint_velocities[world] = 0.0


def put_cube(task, centre):
    """Leave nothing but a cube of 10 cm in world 0."""
    task._boxes[0] = 0.0
    task._boxes[0, 0] = *centre, 0.05, 0.05, 0.05, 0.0
    task._place(np.zeros(1, dtype=np.int32))


def test_boxes_are_observed_as_they_stand():
    env = TaskVectorEnv(8, task=ReachObstaclesTask)
    observations, infos = env.reset(seed=0)
    assert observations.shape == (8, 12 + MAX_OBSTACLES * BOX_NUMBERS)
    assert infos["feasible"].all()
    assert sum(len(env.task.boxes(i)) for i in range(8)) > 20
    for i in range(8):
        seen, there = read_boxes(observations[i, 12:]), env.task.boxes(i)
        assert len(seen) == len(there)
        np.testing.assert_allclose(seen.centres, there.centres, atol=1e-6)
        np.testing.assert_allclose(seen.half_sizes, there.half_sizes, atol=1e-6)
        np.testing.assert_allclose(seen.yaws, there.yaws, atol=1e-6)


def test_simulated_boxes_are_the_ones_told():
    env = TaskVectorEnv(4, task=ReachObstaclesTask)
    env.reset(seed=1)
    for world in range(4):
        data, boxes, model = env.task.simulation.data(world), env.task.boxes(world), env.task.simulation.model
        for i in range(len(boxes)):
            geom = model.geom(f"box_{i}").id
            np.testing.assert_allclose(data.geom_xpos[geom], boxes.centres[i], atol=1e-9)
            np.testing.assert_allclose(model.geom_size[geom], boxes.half_sizes[i])
            np.testing.assert_allclose(data.geom_xmat[geom].reshape(3, 3), boxes.rotations[i], atol=1e-9)
        hidden = [model.geom(f"box_{i}").id for i in range(len(boxes), MAX_OBSTACLES)]
        assert (data.geom_xpos[hidden, 2] < -5).all()


def test_an_arm_touches_what_the_capsule_model_says_it_touches():
    env = TaskVectorEnv(24, task=ReachObstaclesTask, max_episode_steps=None)
    env.reset(seed=0)
    task = env.task
    rng, model = np.random.default_rng(0), ArmModel("ur5")
    agreed = {"free": 0, "touching": 0}
    among = [model.among(task.boxes(world)) for world in range(24)]
    for _ in range(20):
        q = rng.uniform(-np.pi, np.pi, (24, 6))
        for world in range(24):
            set_arm(task, world, q[world])
        task.simulation.refresh()
        touching = task._contacts.current()[:, 0].any(axis=1)
        for world in range(24):
            free = among[world].is_free(q[world])
            assert free != touching[world]
            agreed["free" if free else "touching"] += 1
    assert min(agreed.values()) > 50


@pytest.mark.parametrize("what", ["floor", "obstacle", "itself"])
def test_each_touch_ends_the_episode_and_is_told_from_the_others(what):
    env = TaskVectorEnv(1, task=ReachObstaclesTask, max_episode_steps=None)
    env.reset(seed=0)
    task, model, rng = env.task, ArmModel("ur5"), np.random.default_rng(0)
    tip = model.position(model.home)
    if what == "obstacle":
        put_cube(task, tip)
        q = model.home
    else:
        put_cube(task, (3.0, 0, 1))
        while True:
            q = rng.uniform(-np.pi, np.pi, 6)
            set_arm(task, 0, q)
            task.simulation.refresh()
            touched = task._contacts.current()[0, 0]
            if touched.tolist() == [what == name for name in ("floor", "obstacle", "itself")]:
                break
    set_arm(task, 0, q)
    _, reward, terminated, _, infos = env.step(q[None])
    assert terminated[0]
    assert env.outcomes[infos["outcome_id"][0]] == "collided"
    assert infos["contacts"][what][0]
    assert reward[0] == pytest.approx(-201 + infos["reward_terms"]["goal"][0])
    assert infos["reward_terms"]["collision"][0] == -200


def test_every_layout_is_certified_free_at_home_and_mostly_solved_by_the_expert():
    env = TaskVectorEnv(20, task=ReachObstaclesTask)
    observations, _ = env.reset(seed=100)
    model = ArmModel("ur5")
    certificate, planner = PathCertificate(model), ArmPlanner(model)
    straight = solved = 0
    for i in range(20):
        boxes, target = env.task.boxes(i), observations[i, 9:12].astype(float)
        plan = planner.plan(model.home, target, 0.05, boxes)
        assert len(certificate.path(model.home, target, boxes))
        straight += not plan.searched
        solved += plan.solved
        assert model.among(boxes).is_free(model.home)
        assert boxes.distances(target).min(initial=np.inf) >= 0.05
    assert straight < 18
    assert solved >= 19
    _, _, terminated, _, _ = env.step(hold_still(env))
    assert not terminated.any()


def test_labels_are_the_certificates_whatever_policies_plan(monkeypatch):
    """A starved certificate labels layouts infeasible that the expert solves; a starved expert changes no label."""
    monkeypatch.setattr(ReachObstaclesTask, "_pool", None)
    observations, infos = TaskVectorEnv(8, task=ReachObstaclesTask, solvable=False).reset(seed=100)
    monkeypatch.setattr(ArmPlanner, "plan", None)
    again, same = TaskVectorEnv(8, task=ReachObstaclesTask, solvable=False).reset(seed=100)
    np.testing.assert_array_equal(observations, again)
    np.testing.assert_array_equal(infos["feasible"], same["feasible"])
    assert same["feasible"].all()
    starved = PathCertificate(ArmModel("ur5"), PathCertificateOptions(checks=0))
    monkeypatch.setattr(ReachObstaclesTask, "_certificate", starved)
    assert not TaskVectorEnv(8, task=ReachObstaclesTask, solvable=False).reset(seed=100)[1]["feasible"].any()


def test_worlds_are_those_of_single_environments():
    worlds = TaskVectorEnv(3, task=ReachObstaclesTask)
    together = worlds.reset(seed=5)[0]
    for i in range(3):
        alone = gymnasium.make(ENV).reset(seed=5 + i)[0]
        np.testing.assert_array_equal(alone, together[i])
    again = worlds.reset(seed=5)[0]
    np.testing.assert_array_equal(again, together)


@pytest.mark.slow
def test_other_arms_have_obstacles_too():
    for robot in ("z1", "panda"):
        env = gymnasium.make(ENV, robot=robot)
        observation, info = env.reset(seed=0)
        dof = env.get_wrapper_attr("task").arm.description.dof
        assert observation.shape == (6 + dof + MAX_OBSTACLES * BOX_NUMBERS,)
        assert info["feasible"]
        _, _, terminated, _, _ = env.step(env.get_wrapper_attr("task").arm.description.home)
        assert not terminated


def test_unusable_options_are_refused():
    with pytest.raises(ConfigurationError, match="reachable"):
        gymnasium.make(ENV, target="box")


def test_shapes_in_the_simulation_are_the_capsules():
    env = gymnasium.make(ENV)
    description = env.get_wrapper_attr("task").arm.description
    model = env.get_wrapper_attr("task").simulation.model
    pairs = len(description.collision_pairs) + MAX_OBSTACLES * len(description.capsules)
    assert model.npair == pairs

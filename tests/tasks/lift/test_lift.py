import gymnasium
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.envs import TaskVectorEnv, make_worlds
from armctl.kinematics import ArmModel
from armctl.kinematics.grasp import grasp_path
from armctl.kinematics.vertical_tool import VerticalTool
from armctl.policies import make_policy
from armctl.robots.hand import FORCE, STIFFNESS
from armctl.scene import tabletop
from armctl.scene.lift_table import OPENING
from armctl.simulation.impacts import DEEP, DEPTH
from armctl.tasks import LiftTask

ENV = "armctl/ArmLift-v0"
LIFTED, FELL, RUNNING = 1, 2, -1


def worlds(n=2, **options):
    return TaskVectorEnv(n, task=LiftTask, threads=1, **options)


def move_object(env, position, quaternion=(1.0, 0.0, 0.0, 0.0)):
    """Put all objects at rest at a position (3,) m."""
    task = env.task
    task._object_qpos[:], task._object_qvel[:] = (*position, *quaternion), 0.0
    task.simulation.refresh()


def stay(env, steps, opening=OPENING):
    actions = np.tile(env.task.idle_action, (env.num_envs, 1))
    actions[:, -1] = opening
    for _ in range(steps):
        result = env.step(actions)
    return result


def grasp_at_home(env):
    """Close the hands, at home, around the objects."""
    env.reset(seed=0)
    for _ in range(12):
        move_object(env, env.task.arm.end_effector_positions[0])
        stay(env, 1, opening=0.0)


def test_each_grasp_is_certified_and_on_the_table():
    env = worlds(4)
    _, infos = env.reset(seed=0)
    model, state = ArmModel("panda"), env.task.state
    tool = VerticalTool(model, 0.0, tabletop.table())
    for place, (cos, sin), target in zip(state.object_position, state.object_axis, state.target_position, strict=True):
        points, turns = grasp_path(tool, place[:2], np.arctan2(sin, cos), target[2])
        line = tool.line(points, model.home, turns)
        np.testing.assert_allclose(model.positions(line), points, atol=1e-5)
        assert model.within_limits(line).all()
        assert tool.model.are_free(line).all()
        closing = model.pose(line[-1])[:2, 1]
        assert min(abs(closing @ (cos, sin)), abs(closing @ (-sin, cos))) < 1e-3
        assert (place[:2] > tabletop.TABLE_LOW + 0.1).all()
        assert (place[:2] < tabletop.TABLE_HIGH - 0.1).all()
    assert infos["feasible"].all()


def test_boxes_differ_in_size_and_mass_and_rest_on_the_table():
    env = worlds(6)
    env.reset(seed=1)
    task = env.task
    before, sizes = (
        task.state.object_position.copy(),
        task._object_geom._sizes[:, task.simulation.model.geom("object").id],
    )
    np.testing.assert_allclose(before[:, 2], tabletop.TOP + sizes[:, 2])
    assert np.ptp(sizes, axis=0).min() > 0.003
    (x, y, z), mass = sizes[1], task._masses[1, task._object]
    model = task.simulation.data(1) and task.simulation.model
    np.testing.assert_allclose(
        model.body_inertia[task._object], mass / 3 * np.array((y**2 + z**2, x**2 + z**2, x**2 + y**2))
    )
    stay(env, 30)
    np.testing.assert_allclose(task.state.object_position, before, atol=1e-4)


def test_the_hand_moves_to_its_opening_and_grips_with_its_force():
    env = worlds(1, size=(0.05, 0.05))
    env.reset(seed=2)
    stay(env, 25, opening=0.03)
    assert env.task.state.finger_opening[0, 0] == pytest.approx(0.03, abs=1e-3)
    grasp_at_home(env)
    assert env.task.state.finger_opening[0, 0] == pytest.approx(0.05, abs=1e-3)
    forces = env.task.simulation.data(0).actuator_force[-2:]
    np.testing.assert_allclose(forces, -min(FORCE, 0.025 * STIFFNESS))


@pytest.mark.slow
def test_a_held_object_does_not_slip_for_a_minute():
    env = worlds(2, friction=(0.4, 0.4), mass=(0.5, 0.5), max_episode_steps=2000)
    grasp_at_home(env)
    depths, column = env.task.simulation.array("sensordata"), env.task.simulation.model.sensor(DEPTH).adr[0]
    env.task._targets[:, 2] = 5.0
    stay(env, 10, opening=0.0)
    before, deepest = env.task.state.object_position.copy(), 0.0
    for _ in range(150):
        stay(env, 10, opening=0.0)
        deepest = max(deepest, -depths[:, column].min())
    assert np.abs(env.task.state.object_position - before).max() < 1e-3
    assert 0 < deepest < DEEP


@pytest.mark.parametrize(
    ("height", "opening", "outcome"), [(0.01, 0.0, LIFTED), (0.03, 0.0, RUNNING), (0.0, OPENING, RUNNING)]
)
def test_lifted_is_held_at_the_height(height, opening, outcome):
    env = worlds(1)
    grasp_at_home(env)
    env.task._targets[0, 2] = env.task.state.object_position[0, 2] + height
    *_, infos = stay(env, 1, opening)
    assert infos["outcome_id"][0] == outcome
    assert infos["is_success"][0] == (outcome == LIFTED)


def test_an_object_off_the_table_has_fallen():
    env = worlds(1)
    env.reset(seed=5)
    move_object(env, (0.5, 0.55, 0.06))
    _, rewards, terminated, _, infos = stay(env, 2)
    assert infos["outcome_id"][0] == FELL
    assert terminated.all()
    assert rewards[0] == -301.0


def test_world_i_is_the_single_world_of_seed_plus_i():
    together, actions = worlds(3), np.append(np.full(7, 0.7), 0.02)
    together.reset(seed=5)
    for _ in range(8):
        observations, rewards, *_ = together.step(np.tile(actions, (3, 1)))
    for i in range(3):
        env = gymnasium.make(ENV)
        env.reset(seed=5 + i)
        for _ in range(8):
            alone, reward, *_ = env.step(actions)
        np.testing.assert_array_equal(alone, observations[i])
        assert reward == rewards[i]


def test_a_reset_leaves_nothing_of_the_episode_before():
    env = worlds(2)
    first, _ = env.reset(seed=6)
    stay(env, 10, opening=0.0)
    again, _ = env.reset(seed=6)
    np.testing.assert_array_equal(first, again)
    fresh = worlds(2)
    fresh.reset(seed=6)
    np.testing.assert_array_equal(stay(env, 5, 0.01)[0], stay(fresh, 5, 0.01)[0])


def test_rollouts_of_the_model_move_arm_and_hand_as_the_environment_does():
    env = make_worlds(ENV, 1, options={})
    env.reset(seed=7)
    task = env.task
    action = task.idle_action - 0.02
    model = env._planning_model()
    motion = model.rollout(task.simulation.live_arrays["state"][0].copy(), np.tile(action, (1, 5, 1)))
    for _ in range(5):
        env.step(action[None])
    qpos = task.simulation.array("qpos")[0]
    np.testing.assert_array_equal(motion.qpos[0, -1, :9], qpos[:9])


@pytest.mark.parametrize(
    "options",
    [{"goal": True}, {"robot": "ur5"}, {"size": (0.04, 0.08)}, {"mass": (0.5, 0.2)}, {"friction": (0.0, 1.0)}],
)
def test_unusable_options_are_refused(options):
    with pytest.raises(ConfigurationError):
        gymnasium.make(ENV, **options)


@pytest.mark.parametrize("name", ["reach_ik", "push_line", "random:filter=true"])
def test_policies_for_arms_without_a_hand_refuse(name):
    with pytest.raises(ConfigurationError):
        make_policy(name, make_worlds(ENV, 1, options={}))

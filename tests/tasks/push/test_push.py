import gymnasium
import mujoco
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.envs import TaskVectorEnv, make_worlds
from armctl.kinematics import ArmModel
from armctl.kinematics.vertical_tool import VerticalTool
from armctl.policies import make_policy
from armctl.scene import push_table, tabletop
from armctl.simulation.impacts import DEPTH
from armctl.tasks import PushTask

ENV = "armctl/ArmPush-v0"
PLACED, FELL, RUNNING = 1, 2, -1


def worlds(n=4, **options):
    return TaskVectorEnv(n, task=PushTask, threads=1, **options)


def place(env, object_xy, speed=(0.0, 0.0), height=push_table.TOOL_HEIGHT):
    """Put all objects at a place (2,) m with a speed (2,) m/s."""
    task = env.task
    task._object_qpos[:] = (*object_xy, height, 1.0, 0.0, 0.0, 0.0)
    task._object_qvel[:] = (*speed, 0.0, 0.0, 0.0, 0.0)
    task.simulation.refresh()


def stay(env, steps):
    for _ in range(steps):
        result = env.step(np.tile(env.task.idle_action, (env.num_envs, 1)))
    return result


@pytest.mark.parametrize("robot", ["ur5", pytest.param("panda", marks=pytest.mark.slow)])
def test_each_line_from_object_to_target_is_certified_and_on_the_table(robot):
    env = worlds(robot=robot)
    _, infos = env.reset(seed=0)
    model = ArmModel(robot)
    tool = VerticalTool(model, push_table.TOOL_LENGTH, tabletop.table())
    for start, target in zip(env.task.state.object_position, env.task.state.target_position, strict=True):
        points = push_table.line_points(start[:2], target[:2])
        line = tool.line(points, model.home)
        np.testing.assert_allclose([tool.point(q) for q in line], points, atol=1e-5)
        assert model.within_limits(line).all()
        assert tool.model.are_free(line).all()
        assert 0.1 <= np.hypot(*(target - start)[:2]) <= 0.4
        for x, y in (start[:2], target[:2]):
            assert ((x, y) > tabletop.TABLE_LOW + 0.1).all()
            assert ((x, y) < tabletop.TABLE_HIGH - 0.1).all()
    assert infos["feasible"].all()


def test_an_object_at_rest_stays_where_it_is():
    env = worlds()
    env.reset(seed=1)
    before = env.task.state.object_position.copy()
    stay(env, 40)
    np.testing.assert_allclose(env.task.state.object_position, before, atol=1e-5)


def test_a_sliding_object_brakes_by_its_own_friction_whatever_its_mass():
    env = worlds(8, mass=(0.2, 2.0))
    env.reset(seed=2)
    place(env, (0.5, 0.0), speed=(0.0, 0.5))
    stay(env, 15)
    task = env.task
    slid = task.state.object_position[:, 1]
    expected = 0.5**2 / (2 * 9.81 * task._frictions[:, task._pairs[0], 0])
    np.testing.assert_allclose(slid, expected, rtol=0.1)
    assert np.ptp(task._masses[:, task._object]) > 0.2


def test_masses_reach_the_physics_as_in_a_model_of_that_mass():
    env = worlds(2)
    env.reset(seed=3)
    simulation, body = env.task.simulation, env.task._object
    model = simulation.data(1) and simulation.model
    expected = mujoco.MjModel.__copy__(simulation.nominal_model)
    share = env.task._masses[1, body] / expected.body_mass[body]
    assert model.body_invweight0[body, 0] == pytest.approx(expected.body_invweight0[body, 0] / share)
    np.testing.assert_allclose(model.body_inertia[body], expected.body_inertia[body] * share)


@pytest.mark.parametrize(
    ("offset", "speed", "outcome"), [(0.02, 0.0, PLACED), (0.04, 0.0, RUNNING), (0.0, 0.5, RUNNING)]
)
def test_placed_is_near_the_target_and_at_rest(offset, speed, outcome):
    env = worlds(1, friction=(0.2, 0.2))
    env.reset(seed=4)
    target = env.task._targets[0, :2]
    place(env, (target[0] + offset, target[1]), speed=(0.0, speed))
    *_, infos = stay(env, 1)
    assert infos["outcome_id"][0] == outcome
    assert infos["is_success"][0] == (outcome == PLACED)


@pytest.mark.parametrize("cause", ["off", "over"])
def test_an_object_off_the_table_or_on_another_side_has_fallen(cause):
    env = worlds(1)
    env.reset(seed=5)
    if cause == "off":
        place(env, (0.5, 0.55), height=0.06)
    else:
        place(env, (0.5, 0.0), height=0.11)
        env.task._object_qpos[:, 3:] = (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)
        env.task.simulation.refresh()
    _, rewards, terminated, _, infos = stay(env, 2 if cause == "off" else 1)
    assert infos["outcome_id"][0] == FELL
    assert terminated.all()
    assert rewards[0] == -301.0


def test_world_i_is_the_single_world_of_seed_plus_i():
    together, actions = worlds(3), np.full((3, 6), 0.7)
    together.reset(seed=5)
    for _ in range(8):
        observations, rewards, *_ = together.step(actions)
    for i in range(3):
        env = gymnasium.make(ENV)
        env.reset(seed=5 + i)
        for _ in range(8):
            alone, reward, *_ = env.step(actions[i])
        np.testing.assert_array_equal(alone, observations[i])
        assert reward == rewards[i]


def test_a_reset_leaves_nothing_of_the_episode_before():
    env = worlds(2)
    first, _ = env.reset(seed=6)
    env.action_space.seed(0)
    for _ in range(10):
        env.step(env.action_space.sample())
    again, _ = env.reset(seed=6)
    np.testing.assert_array_equal(first, again)
    played = [env.step(np.full((2, 6), 0.5))[0] for _ in range(5)][-1]
    fresh = worlds(2)
    fresh.reset(seed=6)
    np.testing.assert_array_equal([fresh.step(np.full((2, 6), 0.5))[0] for _ in range(5)][-1], played)


@pytest.mark.slow
@pytest.mark.parametrize("control", ["position", "torque"])
def test_random_actions_press_nothing_deeper_than_the_bound_of_hard_impacts(control):
    env = worlds(8, control=control, actions="normalized")
    simulation = env.task.simulation
    depths, column = simulation.array("sensordata"), simulation.model.sensor(DEPTH).adr[0]
    env.reset(seed=7)
    rng, deepest = np.random.default_rng(0), 0.0
    for step in range(150):
        if step % 10 == 0:
            actions = rng.uniform(-1, 1, (8, 6))
        env.step(actions)
        deepest = max(deepest, -depths[:, column].min())
        assert np.abs(env.task._object_qvel[:, :3]).max() < 20.0
    assert 0.0 < deepest < 0.003
    assert not simulation.unstable.any()


def test_the_bound_on_time_is_below_what_the_expert_needs():
    env = make_worlds(ENV, 3, options={})
    observations, _ = env.reset(seed=[300] * 3, options={"episode": np.arange(3)})
    bounds = np.array([env.task.min_time(world) for world in range(3)])
    policy = make_policy("push_line", env)
    policy.reset(np.arange(3, dtype=np.int32))
    for step in range(30):
        observations, *_ = env.step(policy.act(observations))
        touched = np.hypot(*env.task.state.object_velocity[:, :2].T) > 0.01
        assert ((step + 1) * 0.04 >= bounds[touched]).all()
    assert (bounds > 0.1).all()


@pytest.mark.parametrize("options", [{"goal": True}, {"target": "box"}, {"friction": (0.5, 0.2)}, {"mass": (0.0, 1.0)}])
def test_unusable_options_are_refused(options):
    with pytest.raises(ConfigurationError):
        gymnasium.make(ENV, **options)


@pytest.mark.slow
def test_an_arm_that_reaches_no_line_is_refused():
    with pytest.raises(ConfigurationError, match="z1_description can push along none"):
        gymnasium.make(ENV, robot="z1").reset(seed=0)


@pytest.mark.parametrize("name", ["reach_ik", "reach_mpc"])
def test_experts_that_reach_refuse(name):
    with pytest.raises(ConfigurationError):
        make_policy(name, make_worlds(ENV, 1, options={}))

import math

import gymnasium
import numpy as np
import pinocchio
import pytest

from armctl.core.errors import ConfigurationError
from armctl.envs import TaskVectorEnv, make_worlds
from armctl.kinematics import ArmModel, MinimumTimePose
from armctl.policies import make_policy
from armctl.tasks import ReachPoseTask

ENV = "armctl/ArmPose-v0"


def rotations(axes):
    """Rotation matrices (n, 3, 3) of the observed axes (n, 6)."""
    first, second = axes[:, :3], axes[:, 3:]
    return np.stack((first, second, np.cross(first, second)), axis=2)


def angles(observations):
    """Angles (n,) rad between the observed orientations, by Pinocchio's logarithm."""
    tips, targets = rotations(observations[:, -12:-6]), rotations(observations[:, -6:])
    return np.array([np.linalg.norm(pinocchio.log3(a.T @ b)) for a, b in zip(tips, targets, strict=True)])


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["ur5", "panda", "z1"])
def test_every_target_has_a_free_configuration_within_the_limits(robot):
    env = TaskVectorEnv(16, task=ReachPoseTask, robot=robot)
    observations, infos = env.reset(seed=0)
    model, certificates, dof = ArmModel(robot), env.task.certificates, env.task.robot.dof
    poses = np.array([model.pose(q) for q in certificates])
    np.testing.assert_allclose(poses[:, :3, 3], observations[:, 3 + dof : 6 + dof], atol=1e-6)
    np.testing.assert_allclose(poses[:, :3, :3], rotations(observations[:, -6:]), atol=1e-6)
    assert model.within_limits(certificates).all()
    assert model.are_free(certificates).all()
    assert poses[:, 2, 3].min() >= 0.02
    assert infos["feasible"].all()


def test_observed_axes_are_those_of_the_end_effector_and_the_angle_is_that_of_the_logarithm():
    env = TaskVectorEnv(8, task=ReachPoseTask)
    observations = env.reset(seed=1)[0]
    model = ArmModel("ur5")
    for _ in range(10):
        observations = env.step(env.task.certificates)[0]
        poses = np.array([model.pose(q) for q in env.task.arm.joint_positions])
        np.testing.assert_allclose(poses[:, :3, :3], rotations(observations[:, -12:-6]), atol=1e-5)
    np.testing.assert_allclose(env.task.state.angle, angles(observations.astype(float)), atol=1e-5)
    assert env.task.state.angle.max() > 1.0


@pytest.mark.parametrize(
    ("turn", "angle_tolerance", "wins"), [(0.0, 10.0, True), (0.5, 10.0, False), (0.5, 40.0, True)]
)
def test_is_reached_where_both_position_and_orientation_are_within_their_tolerances(turn, angle_tolerance, wins):
    """The last joint of a UR5 turns the end-effector without moving it."""
    env = TaskVectorEnv(8, task=ReachPoseTask, angle_tolerance=angle_tolerance)
    env.reset(seed=2)
    actions, reached = env.task.certificates.copy(), np.zeros(8, dtype=bool)
    actions[:, 5] += np.where(actions[:, 5] > 0, -turn, turn)
    for _ in range(60):
        _, _, terminated, _, infos = env.step(actions)
        state = env.task.state
        within = (state.distance <= 0.02) & (np.degrees(state.angle) <= angle_tolerance)
        np.testing.assert_array_equal(terminated[~reached], within[~reached])
        np.testing.assert_array_equal(terminated, infos["is_success"])
        reached |= terminated
        if reached.all():
            break
    assert reached.all() if wins else not reached.any()
    assert wins or (state.distance < 0.02).all()


def test_world_i_is_the_single_world_of_seed_plus_i():
    worlds = TaskVectorEnv(3, task=ReachPoseTask)
    together = worlds.reset(seed=5)[0]
    for _ in range(5):
        together, rewards, *_ = worlds.step(np.full((3, 6), 0.7))
    for i in range(3):
        env = gymnasium.make(ENV)
        env.reset(seed=5 + i)
        for _ in range(5):
            alone, reward, *_ = env.step(np.full(6, 0.7))
        np.testing.assert_array_equal(alone, together[i])
        assert reward == rewards[i]


def test_an_arm_that_starts_in_the_position_has_not_reached_the_pose():
    env = TaskVectorEnv(1, task=ReachPoseTask, max_episode_steps=None)
    env.reset(seed=0)
    task = env.task
    home = task.arm.description.home
    pose = ArmModel("ur5").pose(home)
    pose[:3, :3] = pose[:3, :3] @ pinocchio.exp3(np.array((0.0, 0.0, 1.0)))
    task._workspace.sample_pose = lambda *_: (pose, home)
    _, infos = env.reset(seed=1)
    assert not infos["is_success"].any()
    assert task.state.distance[0] < 1e-6
    assert task.state.angle[0] == pytest.approx(1.0, abs=1e-6)
    assert not env.step(home[None])[2].any()


@pytest.mark.slow
def test_no_expert_beats_the_least_time_by_more_than_a_control_step():
    env = make_worlds(ENV, 12, options={})
    observations, _ = env.reset(seed=[3] * 12, options={"episode": np.arange(12)})
    bounds = np.array([env.task.min_time(world) for world in range(12)])
    policy = make_policy("reach_ik", env)
    policy.reset(np.arange(12, dtype=np.int32))
    lengths = np.full(12, 150)
    for step in range(60):
        observations, _, terminated, _, _ = env.step(policy.act(observations))
        lengths[terminated & (lengths == 150)] = step + 1
    assert (lengths * 0.04 >= bounds - 0.04).all()
    assert np.median(lengths * 0.04 / bounds) < 1.2


@pytest.mark.parametrize(
    "options", [{"goal": True}, {"target": "box"}, {"angle_tolerance": 0.0}, {"angle_tolerance": 200.0}]
)
def test_unusable_options_are_refused(options):
    with pytest.raises(ConfigurationError):
        gymnasium.make(ENV, **options)


@pytest.mark.parametrize("name", ["reach_mppi", "reach_ompl", "reach_impedance"])
def test_experts_that_reach_positions_only_refuse(name):
    with pytest.raises(ConfigurationError, match="ArmReach"):
        make_policy(name, make_worlds(ENV, 1, options={}))


def test_the_turn_of_the_features_leads_from_one_orientation_to_the_other():
    env = TaskVectorEnv(4, task=ReachPoseTask, observation="features")
    env.reset(seed=0)
    parts = env.task.observation_parts()
    turns = parts["turn"].reshape(4, 3, 3)
    for turn, angle in zip(turns, env.task.state.angle, strict=True):
        assert np.linalg.norm(pinocchio.log3(turn)) == pytest.approx(angle, abs=1e-5)
    scaled = MinimumTimePose(ArmModel("ur5"), env.task.lever)
    assert scaled.lever == pytest.approx(0.02 / math.radians(10))

import gymnasium
import numpy as np
import pytest

from armctl.envs import TaskVectorEnv
from armctl.policies import make_policy
from armctl.tasks import OBSERVATION, REWARD, ReachTask

ENV = "armctl/ArmReach-v0"
TICKS = 5
"""Of the drives, in a control step."""


def expert_steps(env, seed):
    """Play an episode of the IK expert, and yield each step."""
    policy = make_policy("reach_ik", env)
    observation, _ = env.reset(seed=seed)
    policy.reset(np.zeros(1, dtype=np.int32))
    finished = False
    while not finished:
        step = env.step(policy.act(observation[None])[0])
        observation, finished = step[0], step[2] or step[3]
        yield step


@pytest.mark.slow
def test_ledger_sums_to_the_reward_on_random_episodes():
    env = gymnasium.make_vec(ENV, num_envs=64, max_episode_steps=20, tolerance=0.3)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    goals = 0
    for _ in range(60):
        _, rewards, terminated, _, infos = env.step(rng.uniform(-np.pi, np.pi, (64, 6)))
        np.testing.assert_array_equal(rewards, sum(infos["reward_terms"].values()))
        np.testing.assert_array_equal(infos["reward_terms"]["goal"] == 100, terminated)
        np.testing.assert_array_equal(infos["is_success"], terminated)
        goals += terminated.sum()
    assert goals > 20


@pytest.mark.parametrize("robot", ["ur3", "ur5", "ur10"])
def test_reward_is_minus_one_a_step_and_a_hundred_at_the_goal(robot):
    env = gymnasium.make(ENV, robot=robot)
    for seed in range(5):
        steps = list(expert_steps(env, seed))
        rewards = [step[1] for step in steps]
        assert rewards == [-1.0] * (len(steps) - 1) + [99.0]
        assert steps[-1][2]
        assert steps[-1][4]["outcome"] == "reached"
        assert steps[-1][4]["reward_terms"] == {"step": -1.0, "goal": 100.0}
        assert not any(step[4]["is_success"] for step in steps[:-1])


def test_episode_ends_with_the_first_touch_and_the_world_stands_still_there():
    env = gymnasium.make(ENV, tolerance=0.08)
    task, between = env.get_wrapper_attr("task"), 0
    for seed in range(20):
        *before, last = list(expert_steps(env, seed))
        assert all(np.linalg.norm(step[0][:3] - step[0][-3:]) > 0.08 for step in before)
        distances = task._target_query.distances[:, 0]
        touched = int((distances <= 0.08).argmax())
        assert (distances[:touched] > 0.08).all()
        assert (distances[touched:] == distances[touched]).all()
        assert distances[touched] == pytest.approx(np.linalg.norm(last[0][:3] - last[0][-3:]), abs=1e-6)
        between += touched < TICKS - 1
    assert between > 0


def test_reachable_targets_keep_off_floor_and_base():
    env = TaskVectorEnv(500, task=ReachTask)
    targets = env.reset(seed=0)[0][:, -3:]
    base_radius = 0.075
    assert targets[:, 2].min() >= 0.05 - 1e-6
    near_base = targets[:, 2] < 0.1
    assert np.hypot(targets[near_base, 0], targets[near_base, 1]).min() > base_radius
    assert np.linalg.norm(targets, axis=1).max() > 0.85
    assert np.linalg.norm(targets, axis=1).max() < 1.1


def test_box_targets_say_whether_they_can_be_reached():
    env = TaskVectorEnv(300, task=ReachTask, target="box")
    observations, infos = env.reset(seed=0)
    targets, feasible = observations[:, -3:], infos["feasible"]
    distance = np.linalg.norm(targets - [0, 0, 0.089159], axis=1)
    assert 0.3 < feasible.mean() < 0.9
    assert not feasible[distance > 1.05].any()
    assert feasible[(distance < 0.7) & (distance > 0.4) & (targets[:, 2] > 0.2)].all()
    assert env.step(np.zeros((300, 6)))[4]["feasible"].tolist() == feasible.tolist()


def test_target_touches_nothing():
    env = gymnasium.make(ENV)
    env.reset(seed=0)
    simulation = env.get_wrapper_attr("task").simulation
    geom = simulation.model.geom("target")
    assert geom.contype == geom.conaffinity == 0
    simulation.array("mocap_pos")[:] = env.get_wrapper_attr("task").arm.end_effector_positions
    env.step(np.zeros(6))
    assert not any(geom.id in contact.geom for contact in simulation.data(0).contact)


def test_reward_observation_and_robot_are_replaceable():
    def closeness(state):
        return -state.distance

    env = gymnasium.make(
        ENV,
        reward={"step": REWARD["step"], "closeness": closeness},
        observation={**OBSERVATION, "joint_velocities": lambda state: state.joint_velocities},
        robot="ur10",
    )
    observation, _ = env.reset(seed=0)
    assert observation.shape == (18,)
    observation, reward, _, _, info = env.step(np.zeros(6))
    distance = np.linalg.norm(observation[:3] - observation[9:12])
    assert info["reward_terms"]["closeness"] == pytest.approx(-distance, abs=1e-6)
    assert reward == info["reward_terms"]["closeness"] - 1
    np.testing.assert_allclose(observation[12:], env.get_wrapper_attr("task").state.joint_velocities[0], rtol=1e-6)


def test_progress_telescopes_over_an_episode():
    env = gymnasium.make(ENV, reward={"progress": lambda state: state.previous_distance - state.distance})
    for seed in range(3):
        observation, _ = env.reset(seed=seed)
        start = np.linalg.norm(observation[:3] - observation[-3:])
        steps = list(expert_steps(env, seed))
        end = np.linalg.norm(steps[-1][0][:3] - steps[-1][0][-3:])
        assert sum(step[1] for step in steps) == pytest.approx(start - end, abs=1e-6)


@pytest.mark.slow
def test_arm_is_home_and_still_after_any_reset():
    env = TaskVectorEnv(50, task=ReachTask, control="torque", autoreset_mode="disabled")
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(5):
        for _ in range(10):
            env.step(rng.choice([-150.0, 150.0], (50, 6)))
        env.reset()
        home = env.task.arm.description.home
        np.testing.assert_array_equal(env.task.arm.joint_positions, np.tile(home, (50, 1)))
        assert not env.task.arm.joint_velocities.any()

import numpy as np

from armctl.envs import TaskVectorEnv
from armctl.rl.algorithms.hindsight import has_goals
from armctl.scene import push_table
from armctl.tasks import PushTask, ReachMovingTask, ReachTask
from armctl.tasks.reach.state import GOAL_REWARD

N = 12


def worlds(**options):
    env = TaskVectorEnv(N, task=PushTask, threads=1, **options)
    env.reset(seed=0)
    return env


def place(env, places, velocities, heights=push_table.TOOL_HEIGHT):
    """Put the objects at places (n, 2) m with velocities (n, 2) m/s."""
    task = env.task
    task._object_qpos[:] = 0.0
    task._object_qpos[:, :2], task._object_qpos[:, 2], task._object_qpos[:, 3] = places, heights, 1.0
    task._object_qvel[:] = 0.0
    task._object_qvel[:, :2] = velocities
    task.simulation.refresh()


def around_targets(env, radii, rng):
    """Return places (n, 2) at distances `radii` (n,) m from the targets."""
    angles = rng.uniform(-np.pi, np.pi, N)
    return env.task.state.target_position[:, :2] + radii[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))


def judged(env):
    """Make a control step, and return what the goals make of it, and whether the environment pays for it."""
    task, goals = env.task, env.task.goals
    task.command(np.tile(task.idle_action, (N, 1)))
    task.advance(None)
    paid = task.reward_terms()["goal"] == GOAL_REWARD
    return goals.reached(goals.achieved(task.state), goals.desired(task.state)), paid


def test_goals_are_reached_where_the_environment_pays():
    """Around the tolerance, for objects at rest, objects that slide to a halt, and fast ones."""
    env, rng, verdicts = worlds(), np.random.default_rng(0), []
    for speed in (0.0, 0.01, 0.01, 0.1, 0.5):
        place(env, around_targets(env, rng.normal(0.03, 1e-3, N), rng), rng.normal(0, speed + 1e-12, (N, 2)))
        reached, paid = judged(env)
        np.testing.assert_array_equal(reached, paid)
        verdicts.append(reached.mean())
    assert 0.2 < verdicts[0] < 0.8
    assert verdicts[-1] == 0


def test_goals_agree_with_the_environment_at_the_edge_of_the_tolerance():
    """Off the edge by multiples of the rounding error, which 32-bit places would not tell."""
    env, rng = worlds(), np.random.default_rng(1)
    goals = env.task.goals
    radii = 0.03 + np.spacing(0.03) * rng.integers(-4, 5, N)
    place(env, around_targets(env, radii, rng), np.zeros((N, 2)))
    env.task._update_state(np.zeros((N, 6)))
    state = env.task.state
    reached = goals.reached(goals.achieved(state), goals.desired(state))
    np.testing.assert_array_equal(reached, state.reached)
    assert 0.1 < reached.mean() < 0.9


def test_a_place_is_no_achievement_of_an_object_that_moves_or_has_fallen():
    env, rng = worlds(), np.random.default_rng(2)
    targets = around_targets(env, np.zeros(N), rng)
    for velocity, height, expected in ((0.0, push_table.TOOL_HEIGHT, 1), (0.4, push_table.TOOL_HEIGHT, 0), (0, -1, 0)):
        place(env, targets, np.full((N, 2), velocity), height)
        judged(env)
        achieved = env.task.goals.achieved(env.task.state)
        assert (achieved[:, 2] == expected).all()
        relabelled = np.column_stack((achieved[:, :2], np.ones(N)))
        np.testing.assert_array_equal(env.task.goals.reached(achieved, relabelled), expected == 1)


def test_a_subclass_has_no_goals_but_its_own():
    class MarkedPushTask(PushTask):
        pass

    kinds = (PushTask, MarkedPushTask, ReachTask, ReachMovingTask)
    declared = [has_goals(TaskVectorEnv(1, task=task, threads=1).task) for task in kinds]
    assert declared == [True, False, True, False]

"""Episodes whose physics failed are counted apart, and are no successes; where there are none, nothing is said."""

import numpy as np
import pytest

import armctl
from armctl.study import compare
from armctl.tasks import ReachTask

TOO_MUCH = 1e3


class ExplosiveTask(ReachTask):
    """Physics that fails under actions of `TOO_MUCH`."""

    def command(self, actions):
        super().command(actions)
        self.arm.joint_velocities[(actions >= TOO_MUCH).any(axis=1)] = np.nan


armctl.register("tests/Explosive-v0", ExplosiveTask, max_episode_steps=100)


@armctl.sees("state")
def exploding(env):
    """An expert in whose hands the physics of every second episode fails."""
    expert = armctl.make_policy("reach_ik", env)

    class Exploding:
        sees = "state"
        training_steps = 0

        def reset(self, ids):
            expert.reset(ids)

        def act(self, observations):
            actions = expert.act(observations)
            actions[env.episodes % 2 == 1] = TOO_MUCH
            return actions

    return Exploding()


def words(comparison):
    return " ".join(part.text for part in comparison.document().parts if hasattr(part, "text"))


@pytest.mark.slow
def test_unstable_episodes_are_failures_and_are_told(tmp_path):
    comparison = compare([exploding, "reach_ik"], "tests/Explosive-v0", episodes=6, worlds=3, out=tmp_path)
    broken, whole = comparison.policies
    assert broken.outcomes == {"reached": 3, "unstable": 3}
    assert (broken.success.value, whole.success.value) == (0.5, 1.0)
    assert "exploding: 3 reached, 3 unstable; physics failures: 3, counted as failures" in words(comparison)
    assert "3 of 6 episodes of exploding count as failures, because their physics became unstable." in words(comparison)
    numbers = comparison.episodes.query("policy == 'exploding'")[["return", "path_length", "energy", "speed_use"]]
    assert np.isfinite(numbers.to_numpy(dtype=float)).all()


@pytest.mark.slow
def test_nothing_is_said_where_nothing_was_unstable():
    comparison = compare(["reach_ik", "random"], episodes=6, worlds=3)
    assert [policy.unstable for policy in comparison.policies] == [0, 0]
    assert "unstable" not in words(comparison)
    assert "physics" not in words(comparison)

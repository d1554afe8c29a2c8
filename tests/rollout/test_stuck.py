"""Whoever commands next to nothing for a whole episode is remarked upon."""

import numpy as np
import pytest

from armctl.study import compare

from .test_failing_episodes import Endless  # noqa: F401  # registers its environment

STUCK = "hardly moved"


def still(env):
    class Still:
        def act(self, observation):
            return env.idle_action

    return Still()


def remarks(found):
    return [note for note in found.notes if STUCK in note]


@pytest.mark.parametrize("env", ["armctl/ArmReach-v0", "armctl/BridgeCross-v0"])
def test_a_policy_that_holds_still_is_remarked_upon(env):
    found = compare({"still": still}, env, episodes=2, worlds=2, env_options={"max_episode_steps": 30})
    assert remarks(found) == [
        "still hardly moved in 2 of 2 episodes (a path below 1 cm in at least 1 s, and no success): it may be stuck."
    ]


def test_short_episodes_and_failures_are_no_reason_for_a_remark():
    options = {"max_episode_steps": 20}  # 0.8 s
    assert not remarks(compare({"still": still}, episodes=2, worlds=2, env_options=options))

    class Fails:
        steps = 0

        def reset(self):
            self.steps = 0

        def act(self, observation):
            self.steps += 1
            return observation[3:9] if self.steps < 30 else None

    options = {"max_episode_steps": 40}
    found = compare({"fails": Fails}, episodes=2, worlds=2, env_options=options)
    assert found.policies[0].outcomes == {"error": 2}
    assert not remarks(found)


@pytest.mark.parametrize(("env", "expert"), [("ArmReach", "reach_ik"), ("BridgeCross", "bridge_mpc")])
def test_experts_are_not(env, expert):
    options = {"max_episode_steps": 30}  # too few to win
    found = compare([expert], f"armctl/{env}-v0", episodes=4, worlds=4, env_options=options)
    assert len(found.episodes) == 4
    assert not remarks(found)


def test_environments_that_tell_no_motion_are_not_judged():
    found = compare({"still": lambda observation: np.zeros(1)}, "ForFailing/Endless-v0", episodes=2)
    assert not remarks(found)

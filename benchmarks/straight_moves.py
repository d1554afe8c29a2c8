"""Plays `scenes_imagined` without its network: the same search with moves straight towards its nearest goal."""

from functools import partial
from typing import Any

import numpy as np

import armctl
from armctl.baselines.hybrids.guided_planner import GuidedPlanner, GuidedReach, GuideOptions
from armctl.core.arrays import Array
from armctl.core.seeds import TEST_SEED
from armctl.kinematics import ArmModel, EdgeChecker
from armctl.planning import ArmPlanner, ArmPlannerOptions
from armctl.policies import PerWorld, sees
from armctl.scene import Boxes
from armctl.tasks.reach import CONTROL_PERIOD

LARGEST_MOVE = 0.15
"""rad: that of the labels from which the network has learned."""
EPISODES = 132
"""Number of solvable test problems."""


class StraightMoves:
    """Moves of imagined arms in place of an agent's."""

    goals = np.zeros((0, 6))

    def act(self, observations: Array) -> Array:
        """Return joint positions (n, 6), rad."""
        q = np.asarray(observations[:, 3:9], float)
        moves = self.goals[np.linalg.norm(self.goals - q[:, None], axis=2).argmin(axis=1)] - q
        return np.asarray(q + moves * np.minimum(1.0, LARGEST_MOVE / abs(moves).max(axis=1, keepdims=True)))


class StraightPlanner(GuidedPlanner):
    """Tells its moves the goals."""

    def _search(self, edges: EdgeChecker, start: Array, goals: Array) -> Array:
        self._agent.goals = goals
        return np.asarray(super()._search(edges, start, goals))


class StraightReach(GuidedReach):
    """Plans by straight moves, which see neither target nor boxes."""

    def _planner(self, options: ArmPlannerOptions, target: Array, boxes: Boxes) -> ArmPlanner:
        unseen = np.zeros(3), np.zeros(0)
        return StraightPlanner(self._agent, self._guidance, *unseen, self._model, options, self._search)


@sees("model")
def straight(env: Any) -> PerWorld:
    """Return `scenes_imagined` without its network."""
    setting = ArmModel(env.robot), env.options, CONTROL_PERIOD
    clocks = (partial(env.control_step, i) for i in range(env.num_envs))
    return PerWorld(
        [StraightReach(StraightMoves(), GuideOptions(), *setting, clock) for clock in clocks], prepared=True
    )


def main() -> None:
    """Print how often it reaches the target."""
    comparison = armctl.compare(
        [straight],
        "armctl/ArmScenes-v0",
        episodes=EPISODES,
        seed=TEST_SEED,
        worlds=50,
        env_options={"problems": "test"},
    )
    success = comparison.policies[0].success
    print(f"{100 * success.value:.1f} % of {EPISODES} [{100 * success.low:.1f}, {100 * success.high:.1f}]")


if __name__ == "__main__":
    main()

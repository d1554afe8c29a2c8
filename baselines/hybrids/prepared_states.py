"""States of bridges as an agent should see them: without noise, and as they will be when its command acts.

The rover, its delay and what its drives do are estimated as for the bridge experts (`armctl.estimation.DriveObserver`),
maps with noise are averaged. People are filtered (Kalman) by what agents know of them: they walk straight on, and turn
back before a barrier. Nothing of their future is looked up.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.baselines.bridge_controllers import MapAverage
from armctl.core.arrays import Array
from armctl.envs import TaskVectorEnv
from armctl.estimation.drive_observer import DriveObserver
from armctl.estimation.kalman import EstimationOptions, KalmanFilter, LinearModel
from armctl.scene import BridgeMap
from armctl.scene.pedestrians import turned_back
from armctl.tasks.bridge import CONTROL_PERIOD
from armctl.tasks.bridge.observation import BLOCK, ROVER, WALKER

WALKED = np.eye(WALKER) + CONTROL_PERIOD * np.eye(WALKER, k=2)
"""Transition of a pedestrian's position and velocity in a period."""
DEVIATIONS = (0.02, 0.02, 0.2, 0.2)
"""m and m/s: deviations from that. Who walks along the bridge turns where nobody knows."""
PEOPLE = LinearModel(WALKED, np.diag(np.square(DEVIATIONS)), np.eye(WALKER), 0.05**2 * np.eye(WALKER))
OPTIONS = EstimationOptions(noise_memory=100.0, gate=1.0)
"""No reading is an outlier: the noise is unknown at first."""


class PreparedStates:
    """Estimates for n bridges, on which people turn back `turn` m from the middle.

    In each control step: `observe`, decide, `command`.
    """

    def __init__(self, env: TaskVectorEnv, turn: float) -> None:
        self._env, self._turn, n = env, turn, env.num_envs
        self._rover = DriveObserver(n)
        self._maps = [MapAverage() for _ in range(n)]
        self._people: KalmanFilter | None = None

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Forget bridges `ids`, which are others now."""
        self._rover.reset(ids)
        for i in ids:
            self._maps[i] = MapAverage()
        if self._people is not None:
            people = self._people.count // self._env.num_envs
            self._people.reset(ids=(ids[:, None] * people + np.arange(people)).ravel())

    def observe(self) -> NDArray[np.float32]:
        """Return what `armctl.tasks.bridge.observation.full_state` has of the time at which the next commands act."""
        perceived = self._env.perceived()
        noisy, state = perceived is not self._env.task, perceived.state
        rover, blocks, people = np.split(perceived.state_observation().astype(float), self._places, axis=1)
        ahead = self._rover.observe(np.column_stack((state.poses, state.velocities)), noisy)
        rover = np.column_stack((ahead[:, :2], np.cos(ahead[:, 2]), np.sin(ahead[:, 2]), ahead[:, 3:]))
        if noisy:
            blocks = np.array([self._averaged(i, row) for i, row in enumerate(blocks)]).reshape(blocks.shape)
        people = self._walked(
            self._estimated(people) if noisy else people, np.asarray(CONTROL_PERIOD * self._rover.delay)
        )
        return np.concatenate((rover, blocks, people), axis=1, dtype=np.float32)

    def command(self, velocities: Any) -> Array:
        """Return the commands (n, 2) that lead to `velocities` (n, 2), m/s and rad/s, which are sent now."""
        return self._rover.command(np.asarray(velocities, dtype=float))

    @property
    def _places(self) -> tuple[int, int]:
        return ROVER, ROVER + BLOCK * self._env.task.options.blocks

    def _averaged(self, world: int, blocks: Array) -> Array:
        """Return the mean (k, 5) of all readings of a world's blocks."""
        deck, rows = self._env.task.options, blocks.reshape(-1, BLOCK)
        rows[:, 3:] = np.maximum(rows[:, 3:], 0.0)  # half lengths and widths
        bridge = self._maps[world].with_map(BridgeMap(deck.deck_length, deck.deck_width / 2, rows))
        return np.asarray(bridge.blocks)

    def _estimated(self, people: Array) -> Array:
        """Return estimates (n, k) of positions and velocities."""
        if not people.size:
            return people
        readings = people.reshape(-1, WALKER)
        if self._people is None:
            self._people = KalmanFilter(PEOPLE, len(readings), OPTIONS)
        means = self._people.predict()
        turned = np.abs(means[:, 1]) > self._turn
        means[:, 1] = turned_back(means[:, 1], self._turn)
        means[turned, 3] *= -1
        self._people.update(readings)
        return self._people.mean.reshape(people.shape)

    def _walked(self, people: Array, times: Array) -> Array:
        """Return where people (n, k) will be in `times` (n,) s."""
        walkers = people.reshape(len(people), -1, WALKER).copy()
        walkers[..., :2] += times[:, None, None] * walkers[..., 2:]
        beyond = np.abs(walkers[..., 1]) > self._turn
        walkers[..., 1] = turned_back(walkers[..., 1], self._turn)
        walkers[..., 3] *= np.where(beyond, -1.0, 1.0)
        return walkers.reshape(people.shape)

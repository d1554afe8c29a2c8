"""A recurrent network that commands an arm's joints relative to its own last command, and averages its readings.

Sensor noise reaches every joint reading, and with it each action relative to a reading. The last command is known
without noise: the network remembers it, and sees it, and where it takes the end-effector by the arm's geometry, in
place of the readings. These tell how far the arm lags.

What is observed around the arm stands still, or its velocity is observed too. So its place is a running mean of all
readings, each moved on by the velocities since then: a complementary filter (Higgins, IEEE TAES 11, 1975). While what
stands still is not known well enough, the arm waits.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from armctl.rl.networks.layers import joint_frames
from armctl.rl.networks.recurrent import MEMORY, RecurrentNetwork

COMMAND = "command"
"""Name of the memory of the last command, as its difference to the idle action, rad."""
PLACES, READINGS, VELOCITIES, SPREAD = "places", "readings", "velocities", "spread"
"""Names of the memories of the estimated places and the count of readings, and beside them of the last velocities of
what moves, or of the sum of squared deviations from the mean (Welford, Technometrics 4, 1962) of what stands still."""
LAG_SCALE = 5.0
"""1/rad, 1/m: scales lags of joints and end-effector behind the command to the order of one."""
TIP_NUMBERS = 3
"""Count of numbers of the end-effector's position, with which observations begin."""
SMALL_ERROR = 0.05
"""rad: larger errors, where a teacher may choose another posture, count linearly."""
MOVING_GAIN = 0.07
"""Weight of the latest of many readings of what moves: a fifth of the noise of places is left, and that of velocities
adds 0.11 s times its size."""
PRECISION = 0.01
"""m, rad: standard deviation of the means of what stands still, above which the arm waits."""


@dataclass(frozen=True)
class Layout:
    """Places of an observation's parts, of which the end-effector's position is the first."""

    joints: slice
    """Joint positions."""
    places: slice
    """Positions of what is around the arm."""
    velocities: slice | None
    """Velocities of these; None: all stands still."""
    period: float
    """Seconds between two observations."""


def layout_of(task: Any) -> Layout:
    """Return the parts of an arm's observation."""
    sizes = {name: part.shape[1] for name, part in task.observation_parts().items()}
    ends = dict(zip(sizes, itertools.accumulate(sizes.values()), strict=True))
    slices = {name: slice(ends[name] - size, ends[name]) for name, size in sizes.items()}
    velocities, target = slices.get("target_velocity"), slices["target_position"]
    boxes = slices.get("boxes", target)
    places = slice(target.start, boxes.stop) if boxes.start == target.stop else target
    return Layout(slices["joint_positions"], places, velocities, task.control_period)


class CommandingNetwork(RecurrentNetwork):
    """Maps observations (n, k) to the joint positions (n, dof) to move to, rad.

    `idle` (dof,) is the command at an episode's beginning. Outputs of the last layer are changes of the command, in
    units of `largest_move`, rad. `geometry` is what `ArmModel.geometry` says of the arm.
    """

    idle: torch.Tensor
    turns: torch.Tensor
    offsets: torch.Tensor
    tip: torch.Tensor

    def __init__(
        self,
        features: BaseFeaturesExtractor,
        layout: Layout,
        geometry: Mapping[str, Any],
        *,
        idle: NDArray[Any],
        largest_move: float,
        **sizes: int,
    ) -> None:
        super().__init__(_BesideLag(features, TIP_NUMBERS + len(idle)), actions=len(idle), **sizes)
        self._layout, self._largest_move = layout, largest_move
        count = layout.places.stop - layout.places.start
        self.memory = {MEMORY: (self.unit.hidden_size,), COMMAND: (len(idle),), PLACES: (count,), READINGS: (1,)}
        self.memory |= {SPREAD: (1,)} if layout.velocities is None else {VELOCITIES: (count,)}
        self.register_buffer("idle", torch.tensor(idle, dtype=torch.float32))
        self.register_buffer("turns", torch.tensor([geometry["base"], geometry["sine"], geometry["versine"]]))
        self.register_buffer("offsets", torch.tensor(geometry["offset"]))
        self.register_buffer("tip", torch.tensor(geometry["tip"]))

    def forward(self, observation: Any, *memory: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Return joint positions (n, dof) to move to, rad, and the next memory."""
        inputs, *averaged = self._prepare(observation, *memory[1:])
        change, hidden = super().forward(inputs[:, :-1], memory[0])
        command = self._changed(inputs, change)
        return command, hidden, command - self.idle, *averaged

    def inputs(self, observation: Any, *memory: torch.Tensor) -> torch.Tensor:
        """Return the inputs (n, j) of `replay` for observations (n, k) and the memory.

        They are where the last command takes the end-effector, this command, estimated places, the rest of the
        observation, the lag, and 1 if the arm may move.
        """
        return self._prepare(observation, *memory[1:])[0]

    def _encode(self, inputs: torch.Tensor) -> torch.Tensor:
        return self.encoder(inputs[:, :-1])

    def _actions(self, inputs: torch.Tensor, outputs: torch.Tensor) -> torch.Tensor:
        return self._changed(inputs, outputs)

    def _changed(self, inputs: torch.Tensor, change: torch.Tensor) -> torch.Tensor:
        return inputs[..., self._layout.joints] + self._largest_move * inputs[..., -1:] * change

    def _prepare(self, observation: torch.Tensor, moved: torch.Tensor, *averaged: torch.Tensor) -> list[torch.Tensor]:
        """Return the inputs (n, j), and the next memory of what is averaged."""
        command = self.idle + moved
        *_, (rotation, origin) = joint_frames(self.turns, self.offsets, command)
        commanded = torch.cat((origin + torch.matmul(rotation, self.tip), command), dim=1)
        lag = LAG_SCALE * (observation[:, : self._layout.joints.stop] - commanded)
        is_known, places, *beside = self._average(observation, *averaged)
        rest = observation[:, self._layout.places.stop :]
        return [torch.cat((commanded, places, rest, lag, is_known), dim=1), places, *beside]

    def remember(self, memory: list[torch.Tensor], executed: torch.Tensor) -> list[torch.Tensor]:
        """Return the memory (n, ...) if `executed` (n, dof) were the commands instead of its own."""
        return [memory[0], executed - self.idle, *memory[2:]]

    def errors(self, actions: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        """Return the errors (n, k) of actions, of which large ones count linearly."""
        return torch.nn.functional.smooth_l1_loss(actions, targets, reduction="none", beta=SMALL_ERROR)

    def _average(
        self, observation: torch.Tensor, places: torch.Tensor, readings: torch.Tensor, other: torch.Tensor
    ) -> list[torch.Tensor]:
        """Return whether places are known well enough, (n, 1), estimated places, (n, m), and the memory beside them."""
        layout, readings, latest = self._layout, readings + 1, observation[:, self._layout.places]
        if layout.velocities is not None:
            velocities = observation[:, layout.velocities]
            places = places + layout.period / 2 * (other + velocities)
            places = places + (1 / readings).clamp(min=MOVING_GAIN) * (latest - places)
            return [torch.ones_like(readings), places, readings, velocities]
        mean, present = places + (latest - places) / readings, (latest != 0).float()
        spread = other + (present * (latest - places) * (latest - mean)).sum(dim=1, keepdim=True) / present.sum(
            dim=1, keepdim=True
        )
        variance = spread / (readings - 1).clamp(min=1) / readings
        return [((readings > 1) & (variance < PRECISION**2)).float(), mean, readings, spread]


class _BesideLag(BaseFeaturesExtractor):
    """Features of all but the last numbers, and these."""

    def __init__(self, features: BaseFeaturesExtractor, count: int) -> None:
        super().__init__(features._observation_space, features.features_dim + count)
        self.features, self._count = features, count

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        lag = observations[:, -self._count :]
        return torch.cat((self.features(observations[:, : -self._count]), lag), dim=1)

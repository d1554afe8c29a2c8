"""Feature extractors by name, from which tasks choose (`Task.learner_view`).

Features are computed from the observation inside the exported graph: an agent sees what any policy sees.
"""

import itertools
from collections.abc import Mapping
from typing import Any

import gymnasium
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, CombinedExtractor, FlattenExtractor

from armctl.core.errors import unknown_name
from armctl.core.registration import import_attribute
from armctl.rl.networks.box_distance_features import BoxDistanceFeatures
from armctl.rl.networks.bridge_ranges import ColumnRanges, FloorRanges, HeldNearnessFeatures, NearnessFeatures
from armctl.rl.networks.bridge_scans import Surroundings
from armctl.rl.networks.layers import (
    NEARBY_TURN,
    TURN_NUMBERS,
    hidden_layers,
    in_first_joint_frame,
    missing_turn,
    rotated,
)
from armctl.rl.networks.lift_features import LiftFeatures
from armctl.rl.networks.link_box_features import LinkBoxFeatures
from armctl.rl.networks.push_features import PushFeatures
from armctl.rl.networks.route_features import RouteFeatures
from armctl.scene import BOX_NUMBERS
from armctl.tasks.reach import observation_sizes
from armctl.tasks.reach.observation import LENGTH_SCALE, NEARBY

AXES = "end_effector_axes", "target_axes"
"""Parts of an observation that are two axes of a pose each."""
DIRECTION = slice(10, 13)
"""Place of the direction to the target among the features of an arm."""


class ReachFeatures(BaseFeaturesExtractor):
    """Positions, the offset to the target, each joint's sine and cosine, and the rest of the observation."""

    def __init__(self, observation_space: spaces.Box, dof: int) -> None:
        parts = list(observation_sizes(dof).values())
        rest = observation_space.shape[0] - sum(parts)
        self.sizes = [*parts, rest]
        super().__init__(observation_space, 13 + 2 * dof + rest)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features (n, 13 + 2 dof + k) of observations (n, 6 + dof + k)."""
        end_effector, joints, target, rest = observations.split(self.sizes, dim=1)
        offset = target - end_effector
        distance = offset.norm(dim=1, keepdim=True)
        direction = offset / (distance + NEARBY)
        lengths = LENGTH_SCALE * torch.cat((end_effector, target, offset, distance), dim=1)
        return torch.cat((lengths, direction, joints.sin(), joints.cos(), rest), dim=1)


class BaseYawInvariantFeatures(BaseFeaturesExtractor):
    """`ReachFeatures` in the frame of an arm's first joint, whose axis is vertical: rotating the scene changes nothing.

    `parts` are the names and sizes of the observation's parts after the target position. The target's velocity, the
    boxes and the axes of a pose are rotated as well; axes also give the turn that is missing. One small network encodes
    each box, and max pooling makes the result independent of their order (Qi et al., PointNet, 2017).
    """

    def __init__(self, observation_space: spaces.Box, dof: int, parts: dict[str, int], box_features: int = 64) -> None:
        self.parts = dict(parts)
        has_boxes = "boxes" in parts
        rest = sum(size for name, size in parts.items() if name != "boxes") + (box_features if has_boxes else 0)
        rest += TURN_NUMBERS if "target_axes" in parts else 0
        super().__init__(observation_space, 13 + 2 * (dof - 1) + rest)
        self.sizes = [*observation_sizes(dof).values(), *parts.values()]
        sizes = [box_features if name == "boxes" else size for name, size in parts.items()]
        begins = itertools.accumulate(sizes, initial=DIRECTION.stop + 2 * (dof - 1))
        slices = {name: slice(begin, begin + size) for name, begin, size in zip(parts, begins, sizes, strict=False)}
        self.axes = [slices[name] for name in AXES if name in slices]
        self.num_errors = 3 + (6 if self.axes else 0)
        """Number of `errors`."""
        if has_boxes:
            self.boxes = torch.nn.Sequential(*hidden_layers((BOX_NUMBERS + 4, box_features, box_features)))

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Return features (n, k) of observations (n, 6 + dof + rest)."""
        tip, joints, target, *rest = observations.split(self.sizes, dim=1)
        yaw = joints[:, :1]
        features, target = in_first_joint_frame(tip, joints, yaw, target, _norm)
        axes = []
        for name, part in zip(self.parts, rest, strict=True):
            if name == "boxes":
                features.append(self._encode_boxes(part, yaw, target))
            elif name in AXES:
                axes.append(rotated(part.unflatten(1, (2, 3)), -yaw[:, None]))
                features.append(axes[-1].flatten(1))
            else:
                features.append(rotated(part, -yaw) if name == "target_velocity" else part)
        return torch.cat((*features, *([missing_turn(*axes)] if axes else [])), dim=1)

    def errors(self, features: torch.Tensor) -> torch.Tensor:
        """Return numbers (n, `num_errors`) made of features, all of which vanish at the target and nowhere else.

        They are the direction to the target, which fades, and that from the end-effector's axes to those of a pose.
        """
        direction = features[:, DIRECTION]
        if not self.axes:
            return direction
        tip, target = self.axes
        turn = features[:, target] - features[:, tip]
        return torch.cat((direction, turn / (_norm(turn) + NEARBY_TURN)), dim=1)

    def _encode_boxes(self, numbers: torch.Tensor, base_yaw: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        boxes = numbers.unflatten(1, (-1, BOX_NUMBERS))
        base_yaw = base_yaw[:, None]
        centre, half_sizes = rotated(boxes[..., :3], -base_yaw), boxes[..., 3:6]
        yaw = 2 * (boxes[..., 6:] - base_yaw)  # a box rotated by pi is the same
        parts = (centre, centre - target[:, None], half_sizes, yaw.sin(), yaw.cos())
        present = (half_sizes > 0).all(dim=-1, keepdim=True)
        return (self.boxes(LENGTH_SCALE * torch.cat(parts, dim=-1)) * present).amax(dim=1)


def _norm(vectors: torch.Tensor) -> torch.Tensor:
    return vectors.norm(dim=1, keepdim=True)


FEATURES: dict[str, type[BaseFeaturesExtractor]] = {
    "reach": ReachFeatures,
    "base_yaw_invariant": BaseYawInvariantFeatures,
    "links_among_boxes": LinkBoxFeatures,
    "distances_among_boxes": BoxDistanceFeatures,
    "lift": LiftFeatures,
    "push": PushFeatures,
    "nearness": NearnessFeatures,
    "held_nearness": HeldNearnessFeatures,
    "routes": RouteFeatures,
    "surroundings": Surroundings,
}


PREPARATIONS: dict[str, type[torch.nn.Module]] = {"column_ranges": ColumnRanges, "floor_ranges": FloorRanges}


def preparation_by_name(name: str) -> type[torch.nn.Module]:
    """Return what makes an observation smaller, by name or `module:Class`. Raises `ConfigurationError`."""
    return _by_name("preparation", name, PREPARATIONS)


def features_by_name(name: str | None, observation_space: gymnasium.Space[object]) -> type[BaseFeaturesExtractor]:
    """Return a feature extractor by name or `module:Class`; without a name, one that passes the bare observation on.

    Raises `ConfigurationError`.
    """
    if name is None:
        return CombinedExtractor if isinstance(observation_space, gymnasium.spaces.Dict) else FlattenExtractor
    return _by_name("features", name, FEATURES)


def _by_name(kind: str, name: str, classes: Mapping[str, Any]) -> Any:
    if ":" in name:
        return import_attribute(name, kind)
    if name not in classes:
        raise unknown_name(kind, name, [*classes, "module:Class"])
    return classes[name]

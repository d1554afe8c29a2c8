"""What networks are shown of an observation: features by name, which tasks choose from (`Task.learner_view`).

They are functions of the observation inside the exported graph: the agent sees what any policy sees.
"""

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor, CombinedExtractor, FlattenExtractor

from armctl.errors import unknown_name
from armctl.registration import import_attribute

LENGTH_SCALE = 2.0
"""1/m: brings the lengths of an arm's workspace to the order of one."""
BOX_NUMBERS = 7
"""In the observation of a box: see `armctl.tasks.reach.obstacles`."""
NEARBY = 0.05
"""m from the target, below which its direction fades."""
NEAR = 0.5
"""m: inverse depth is NEAR / (NEAR + depth)."""


class ReachFeatures(BaseFeaturesExtractor):
    """Observation (6 + dof + k,) as positions, the offset to the target, each joint's sine and cosine, and the rest."""

    def __init__(self, observation_space: spaces.Box, dof: int) -> None:
        self.parts = (3, dof, 3, observation_space.shape[0] - 6 - dof)
        super().__init__(observation_space, 13 + 2 * dof + self.parts[3])

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Features (n, 13 + 2 dof + k) of observations (n, 6 + dof + k)."""
        end_effector, joints, target, rest = observations.split(self.parts, dim=1)
        offset = target - end_effector
        distance = offset.norm(dim=1, keepdim=True)
        direction = offset / (distance + NEARBY)
        lengths = LENGTH_SCALE * torch.cat((end_effector, target, offset, distance), dim=1)
        return torch.cat((lengths, direction, joints.sin(), joints.cos(), rest), dim=1)


class BaseYawInvariantFeatures(BaseFeaturesExtractor):
    """The same in the frame of an arm's first joint, whose axis is vertical: a rotation of the scene changes nothing.

    `parts` are the names and sizes of the observation's parts after the target position. The velocity of a target is
    rotated as well, and so are boxes. The same small network sees each box, and the largest answers are kept (Qi et
    al., PointNet, 2017), so that their order does not matter.
    """

    def __init__(self, observation_space: spaces.Box, dof: int, parts: dict[str, int], box_features: int = 64) -> None:
        self.sizes = dict(parts)
        boxed = "boxes" in parts
        rest = sum(size for name, size in parts.items() if name != "boxes") + (box_features if boxed else 0)
        super().__init__(observation_space, 13 + 2 * (dof - 1) + rest)
        self.dof = dof
        if boxed:
            self.boxes = torch.nn.Sequential(
                torch.nn.Linear(BOX_NUMBERS + 4, box_features),
                torch.nn.ReLU(),
                torch.nn.Linear(box_features, box_features),
                torch.nn.ReLU(),
            )

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Features (n, k) of observations (n, 6 + dof + rest)."""
        tip, joints, target, *rest = observations.split((3, self.dof, 3, *self.sizes.values()), dim=1)
        turn = joints[:, :1]
        tip, target = rotated(tip, -turn), rotated(target, -turn)
        offset = target - tip
        distance = offset.norm(dim=1, keepdim=True)
        lengths = LENGTH_SCALE * torch.cat((tip, target, offset, distance), dim=1)
        seen = [lengths, offset / (distance + NEARBY), joints[:, 1:].sin(), joints[:, 1:].cos()]
        for name, part in zip(self.sizes, rest, strict=True):
            if name == "boxes":
                seen.append(self._see_boxes(part, turn, target))
            else:
                seen.append(rotated(part, -turn) if name == "target_velocity" else part)
        return torch.cat(seen, dim=1)

    def _see_boxes(self, numbers: torch.Tensor, turn: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
        boxes = numbers.unflatten(1, (-1, BOX_NUMBERS))
        turn = turn[:, None]
        centre, half_sizes = rotated(boxes[..., :3], -turn), boxes[..., 3:6]
        yaw = 2 * (boxes[..., 6:] - turn)  # a box rotated by pi is the same
        parts = (centre, centre - target[:, None], half_sizes, yaw.sin(), yaw.cos())
        there = (half_sizes > 0).all(dim=-1, keepdim=True)
        return (self.boxes(LENGTH_SCALE * torch.cat(parts, dim=-1)) * there).amax(dim=1)


def rotated(vectors: torch.Tensor, angles: torch.Tensor) -> torch.Tensor:
    """Vectors (..., 3) rotated about the vertical by angles (..., 1), rad."""
    x, y, z = vectors.split(1, dim=-1)
    return torch.cat((angles.cos() * x - angles.sin() * y, angles.sin() * x + angles.cos() * y, z), dim=-1)


class InverseDepthFeatures(BaseFeaturesExtractor):
    """Inverse depths of all pixels, and own motion."""

    def __init__(self, observation_space: spaces.Dict, size: int = 128) -> None:
        super().__init__(observation_space, size + 3)
        image = observation_space["image"]
        assert isinstance(image, spaces.Box)
        self.image = torch.nn.Sequential(
            torch.nn.Flatten(), torch.nn.Linear(int(np.prod(image.shape)), size), torch.nn.ELU()
        )

    def forward(self, observations: dict[str, torch.Tensor]) -> torch.Tensor:
        """Features (n, size + 3) of images (n, height, width) and motions (n, 3)."""
        inverse = 2 * NEAR / (NEAR + observations["image"])
        return torch.cat((self.image(inverse), observations["motion"]), dim=1)


FEATURES: dict[str, type[BaseFeaturesExtractor]] = {
    "reach": ReachFeatures,
    "base_yaw_invariant": BaseYawInvariantFeatures,
    "inverse_depth": InverseDepthFeatures,
}


def features_by_name(name: str | None, observed: gymnasium.Space[object]) -> type[BaseFeaturesExtractor]:
    """A feature extractor by name, or by its `module:Class`; without a name, that of the bare observation.

    Raises `ConfigurationError`.
    """
    if name is None:
        return CombinedExtractor if isinstance(observed, gymnasium.spaces.Dict) else FlattenExtractor
    if ":" in name:
        return import_attribute(name, "features")
    if name not in FEATURES:
        raise unknown_name("features", name, [*FEATURES, "module:Class"])
    return FEATURES[name]

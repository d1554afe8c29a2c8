"""A learned agent that sees noisy depth images as a scanner understands them: floor, what stands on it, and holes.

`bridge_ppo` and `bridge_moving_ppo` were trained without noise: they find the camera's pitch by two rows of the image,
and take the nearest point of each column for an obstacle, so that 0.05 m of noise blind them. Where the floor in the
image is not flat, `armctl.estimation.depth_scan` reads it by medians of many rows, and the agent sees what that has
understood, painted anew. Images without noise reach the agent as they are.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.agents import OnnxPolicy
from armctl.baselines.bridge_lidar_ompl import CAMERA
from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.core.options import Positive, changed_options, options
from armctl.envs import ModelInterface, Sees
from armctl.estimation.depth_ranges import DepthCamera
from armctl.estimation.depth_scan import MAD_TO_STD, DepthScanner
from armctl.policies import made_for, make_policy, sees
from armctl.robots.rover import CAMERA_PITCH
from armctl.tasks.bridge import BridgeMovingOptions, BridgeOptions


@options
class CleanedOptions:
    """Options of `bridge_cleaned`."""

    agent: str = ""
    """Name of the agent, or path of its card; by default `bridge_moving_ppo` among people, and else `bridge_ppo`."""
    noisy: Positive = 0.01
    """Standard deviation of the depths, m, above which images are cleaned."""


@made_for("armctl/BridgeCross*", controls="rover")
@sees("model", family="cleaned images", kind="hybrid")
def make(env: ModelInterface, options: Mapping[str, Any] = MappingProxyType({})) -> "CleanedPolicy":
    """`bridge_moving_ppo` or `bridge_ppo`, with depth images from which a classical scanner has removed the noise."""
    choice, task = changed_options(CleanedOptions(), options, "option of bridge_cleaned"), env.options
    if not isinstance(task, BridgeOptions):
        raise ConfigurationError("bridge_cleaned cannot play this task: use it with armctl/BridgeCrossMoving-v0")
    name = choice.agent or ("bridge_moving_ppo" if isinstance(task, BridgeMovingOptions) else "bridge_ppo")
    agent = make_policy(name, env)
    if not isinstance(agent, OnnxPolicy):
        raise ConfigurationError(f"images are cleaned for learned agents only, and {name} is none")
    return CleanedPolicy(agent, task, choice.noisy)


class CleanedPolicy:
    """n agents, each of which acts in its own world by cleaned images."""

    sees: Sees = "model"

    def __init__(self, agent: OnnxPolicy, task: BridgeOptions, noisy: float) -> None:
        self.card, self.training_steps, self.training_cost = agent.card, agent.training_steps, agent.training_cost
        width, height = task.size
        camera = DepthCamera(height, width, task.field_of_view, task.camera_range, CAMERA_PITCH)
        self._scanner, self._agent, self._noisy = DepthScanner(camera, CAMERA), agent, noisy

    def reset(self, ids: NDArray[np.int32]) -> None:
        """Begin new episodes in worlds `ids`."""
        self._agent.reset(ids)

    def act(self, observations: Any) -> Array:
        """Return linear and angular velocities (n, 2), m/s and rad/s."""
        images = np.stack([self._cleaned(image) for image in observations["image"]])
        return np.asarray(self._agent.act({**observations, "image": images}))

    def _cleaned(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return an image (height, width), painted anew if it is noisy."""
        scan = self._scanner.scan(image) if noise_of(image) > self._noisy else None
        return image if scan is None else self._scanner.painted(image, scan)


def noise_of(image: NDArray[Any]) -> float:
    """Return the standard deviation of an image's noise: most rows of its lower half see a floor, linear in them."""
    lower = image[len(image) // 2 :].astype(float)
    return MAD_TO_STD * float(np.median(np.abs(np.diff(lower, 2, axis=1)))) / math.sqrt(6.0)

"""The pictures of README and docs: python docs/make_pictures.py."""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import imageio.v3 as imageio
import numpy as np
from numpy.typing import NDArray
from PIL import Image

import armctl
from armctl.envs import batch_of_one
from armctl.simulation import Camera

FOLDER = Path(__file__).parent
Array = NDArray[np.uint8]
LookAt = Callable[[Any], tuple[float, float, float]]
PIXEL = 8
"""Pixels of the picture for each pixel of the rover's camera."""
CLASS_COLOURS = np.array(
    [
        (178, 208, 235),
        (80, 80, 84),
        (120, 110, 100),
        (205, 200, 190),
        (40, 80, 160),
        (245, 245, 245),
        (55, 105, 125),
    ],
    dtype=np.uint8,
)
"""Colours of sky, floor, deck, barrier, obstacle, goal and ground."""

for env_id, name, seed, steps, picture in (
    ("armctl/ArmReach-v0", "reach_ik", 3, 4, "arm_reach.png"),
    ("armctl/ArmPose-v0", "reach_ik", 3, 12, "arm_pose.png"),
    ("armctl/ArmPush-v0", "push_line", 3, 38, "arm_push.png"),
    ("armctl/ArmLift-v0", "lift_grasp", 5, 58, "arm_lift.png"),
    ("armctl/ArmScenes-v0", "reach_ompl", 3, 28, "arm_scenes.png"),
    ("armctl/BarnCross-v0", "bridge_ompl", 3, 25, "barn.png"),
    ("armctl/BarnCrossMoving-v0", "bridge_mpc", 4, 55, "barn_moving.png"),
    (
        "armctl/ArmReachObstacles-v0",
        "reach_ompl",
        2,
        12,
        "arm_reach_obstacles.png",
    ),
):
    env = gymnasium.make(env_id, render_mode="rgb_array")
    policy = armctl.make_policy(name, env)
    observation, _ = env.reset(seed=seed)
    policy.reset(np.zeros(1, dtype=np.int32))
    for _ in range(steps):
        observation, *_ = env.step(policy.act(batch_of_one(observation))[0])
    imageio.imwrite(FOLDER / picture, env.render())

bridge = "armctl/BridgeCrossMoving-v0"
views = {
    camera: gymnasium.make(bridge, camera=camera)
    for camera in ("depth", "classes", "rgb")
}
policy = armctl.make_policy("bridge_ompl", views["depth"])
seen = {
    camera: view.reset(seed=6)[0]["image"] for camera, view in views.items()
}
policy.reset(np.zeros(1, dtype=np.int32))
for _ in range(15):
    action = policy.act(seen)[0]
    seen = {
        camera: view.step(action)[0]["image"] for camera, view in views.items()
    }
simulation = views["depth"].unwrapped.task.simulation
imageio.imwrite(
    FOLDER / "bridge.png",
    Camera(simulation.model, "overview", 960, 540).picture(simulation.data(0)),
)
near = np.uint8(255 * (1 - seen["depth"] / 10) ** 2)
images = (
    np.repeat(near[..., None], 3, axis=2),
    CLASS_COLOURS[seen["classes"]],
    seen["rgb"],
)
framed = [
    np.pad(
        image.repeat(PIXEL, axis=0).repeat(PIXEL, axis=1),
        ((0, 0), (0, 12), (0, 0)),
        constant_values=255,
    )
    for image in images
]
imageio.imwrite(
    FOLDER / "bridge_cameras.png", np.concatenate(framed, axis=1)[:, :-12]
)

# Films, in real time: of both worlds, and of how agents fail.
FRAMES_PER_SECOND = 10


def film(
    env_id: str,
    name: str,
    seed: int,
    seconds: int,
    distance: float,
    azimuth: float,
    look_at: LookAt,
) -> list[Array]:
    """Return the pictures of an episode, the last one repeated until the film ends."""
    import mujoco  # after armctl, which chooses its graphics

    env = gymnasium.make(env_id)
    task = env.unwrapped.task
    policy = armctl.make_policy(name, env)
    view = mujoco.MjvCamera()
    view.distance, view.azimuth, view.elevation = distance, azimuth, -30
    camera = Camera(task.simulation.model, view, 480, 360)
    observation, _ = env.reset(seed=seed)
    policy.reset(np.zeros(1, dtype=np.int32))
    frames, steps, over = [], 0, False
    for frame in range(FRAMES_PER_SECOND * seconds):
        while (
            not over
            and steps * FRAMES_PER_SECOND < frame * env.metadata["render_fps"]
        ):
            observation, _, terminated, truncated, _ = env.step(
                policy.act(batch_of_one(observation))[0]
            )
            steps, over = steps + 1, terminated or truncated
        view.lookat[:] = look_at(task)
        frames.append(camera.picture(task.simulation.data(0)))
    return frames


def first_failure(env_id: str, name: str, seconds: int) -> int:
    """Return the first seed of an episode in which a policy fails at least a second before this time."""
    env = gymnasium.make(env_id)
    policy = armctl.make_policy(name, env)
    for seed in itertools.count():
        observation, _ = env.reset(seed=seed)
        policy.reset(np.zeros(1, dtype=np.int32))
        steps, terminated, truncated = 0, False, False
        while not (terminated or truncated):
            observation, _, terminated, truncated, info = env.step(
                policy.act(batch_of_one(observation))[0]
            )
            steps += 1
        if (
            terminated
            and not info["is_success"]
            and steps < (seconds - 1) * env.metadata["render_fps"]
        ):
            return seed
    raise AssertionError


def save(picture: str, left: list[Array], right: list[Array]) -> None:
    """Save two films side by side."""
    both = [
        Image.fromarray(np.concatenate(pair, axis=1))
        for pair in zip(left, right, strict=True)
    ]
    both[0].save(
        FOLDER / picture,
        save_all=True,
        append_images=both[1:],
        duration=1000 // FRAMES_PER_SECOND,
        loop=0,
        quality=60,
        method=6,
    )


def ahead_of_rover(task: Any) -> tuple[float, float, float]:
    """Return a position on the bridge that moves with the rover."""
    return min(float(task.state.poses[0, 0]) + 1.5, 18.0), 0.0, 0.3


arm, rover = (
    (1.8, 135.0, lambda task: (0.0, 0.0, 0.4)),
    (6.0, 12.0, ahead_of_rover),
)
MOVING, OBSTACLES = "armctl/ArmReachMoving-v0", "armctl/ArmReachObstacles-v0"
save(
    "worlds.webp",
    film(MOVING, "reach_mpc", 3, 11, *arm),
    film(bridge, "bridge_mpc", 2, 11, *rover),
)
failing = [
    film(env_id, name, first_failure(env_id, name, 8), 8, *view)
    for env_id, name, view in (
        (OBSTACLES, "obstacles_plan_bc", arm),
        (bridge, "bridge_moving_distil", rover),
    )
]
save("failures.webp", *failing)

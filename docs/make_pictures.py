"""The README's pictures: python docs/make_pictures.py."""

from pathlib import Path

import gymnasium
import imageio.v3 as imageio
import numpy as np

import armctl
from armctl.simulation import Camera

FOLDER = Path(__file__).parent
PIXEL = 8
"""Pixels of the picture for one of the rover's camera."""
CLASS_COLOURS = np.array(
    [(178, 208, 235), (80, 80, 84), (120, 110, 100), (205, 200, 190), (40, 80, 160), (245, 245, 245), (55, 105, 125)],
    dtype=np.uint8,
)
"""Of sky, floor, deck, barrier, obstacle, goal and ground."""

for env_id, name, seed, steps, picture in (
    ("armctl/ArmReach-v0", "reach_ik", 3, 4, "arm_reach.png"),
    ("armctl/ArmReachObstacles-v0", "reach_ompl", 2, 12, "arm_reach_obstacles.png"),
):
    env = gymnasium.make(env_id, render_mode="rgb_array")
    policy = armctl.make_policy(name, env)
    observation, _ = env.reset(seed=seed)
    policy.reset(np.zeros(1, dtype=np.int32))
    for _ in range(steps):
        observation, *_ = env.step(policy.act(observation[None])[0])
    imageio.imwrite(FOLDER / picture, env.render())

bridge = "armctl/BridgeCrossMoving-v0"
views = {camera: gymnasium.make(bridge, camera=camera) for camera in ("depth", "classes", "rgb")}
driver = armctl.make_policy("bridge_ompl", views["depth"])
seen = {camera: view.reset(seed=6)[0]["image"] for camera, view in views.items()}
driver.reset(np.zeros(1, dtype=np.int32))
for _ in range(15):
    action = driver.act(seen)[0]
    seen = {camera: view.step(action)[0]["image"] for camera, view in views.items()}
simulation = views["depth"].unwrapped.task.simulation
imageio.imwrite(FOLDER / "bridge.png", Camera(simulation.model, "overview", 960, 540).picture(simulation.data(0)))
near = np.uint8(255 * (1 - seen["depth"] / 10) ** 2)
images = (np.repeat(near[..., None], 3, axis=2), CLASS_COLOURS[seen["classes"]], seen["rgb"])
framed = [
    np.pad(image.repeat(PIXEL, axis=0).repeat(PIXEL, axis=1), ((0, 0), (0, 12), (0, 0)), constant_values=255)
    for image in images
]
imageio.imwrite(FOLDER / "bridge_cameras.png", np.concatenate(framed, axis=1)[:, :-12])

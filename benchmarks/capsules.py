"""Contacts of an arm's meshes that its capsules miss, and contacts of its capsules that are none.

    python benchmarks/capsules.py [--robot ur5] [--configurations 10000]

Random configurations, the floor, and random boxes. The truth is MuJoCo's collision detection on the convex hulls of the
arm's own collision meshes, in the same pairs of links.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
import typer
from numpy.typing import NDArray
from rich.box import MARKDOWN
from rich.console import Console
from rich.table import Table

from armctl.kinematics import ArmModel
from armctl.robot_description.collision_pairs import FLOOR, link_frame
from armctl.scene import Boxes

BOXES = 6
PER_LAYOUT = 50
"""Configurations before the boxes are moved."""


@dataclass
class Counts:
    """Counts of configurations, each a row of whether something touches: (capsules, meshes)."""

    touching: NDArray[np.bool_]

    @property
    def missed(self) -> int:
        """The meshes touch, but the capsules do not."""
        return int((~self.touching[:, 0] & self.touching[:, 1]).sum())

    @property
    def over_careful(self) -> float:
        """Part of what the meshes leave free that capsules do not."""
        free = ~self.touching[:, 1]
        return float((self.touching[:, 0] & free).sum() / free.sum())


def mesh_world(arm: ArmModel, half_sizes: NDArray[np.float64]) -> mujoco.MjModel:
    """Return the arm with its collision meshes, a floor, and boxes that can be moved."""
    description, frames = arm.description, arm.pinocchio.frames
    head, tail = description.urdf.split(">", 1)
    options = '<mujoco><compiler fusestatic="false" balanceinertia="false"/></mujoco>'
    spec = mujoco.MjSpec.from_string(f"{head}>{options}{tail}")
    silent = {"contype": 0, "conaffinity": 0}
    geoms: dict[str, list[str]] = {FLOOR: [FLOOR]}
    spec.worldbody.add_geom(name=FLOOR, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], **silent)
    for i, mesh in enumerate(description.meshes):
        name = f"{mesh.link} {i}"
        spec.add_mesh(name=name, uservert=mesh.vertices.ravel(), userface=mesh.triangles.ravel())
        body = spec.body(mesh.link) or spec.worldbody
        body.add_geom(name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, mass=0, **silent)
        geoms.setdefault(mesh.link, []).append(name)
    for i, half_size in enumerate(half_sizes):
        body = spec.worldbody.add_body(name=f"box {i}", mocap=True)
        body.add_geom(name=f"box {i}", type=mujoco.mjtGeom.mjGEOM_BOX, size=half_size, **silent)
    moving = [link for link in geoms if link != FLOOR and frames[link_frame(arm.pinocchio, link)].parentJoint > 0]
    pairs = [
        (a, b)
        for first, second in description.collision_pairs
        for a in geoms.get(first, [])
        for b in geoms.get(second, [])
    ]
    pairs += [(a, f"box {i}") for link in moving for a in geoms[link] for i in range(len(half_sizes))]
    for first, second in pairs:
        spec.add_pair(geomname1=first, geomname2=second)
    return spec.compile()


def measure(robot: str, configurations: int) -> tuple[Counts, Counts]:
    """Return what touches by the arm itself and the floor, and by boxes too."""
    rng = np.random.default_rng(0)
    arm = ArmModel(robot)
    half_sizes = rng.uniform(0.03, 0.15, (BOXES, 3))
    world = mesh_world(arm, half_sizes)
    data, box_geoms = mujoco.MjData(world), [world.geom(f"box {i}").id for i in range(BOXES)]
    by_arm, by_all = [], []
    low, high = np.maximum(arm.limits.lower, -np.pi), np.minimum(arm.limits.upper, np.pi)
    for i in range(configurations):
        if i % PER_LAYOUT == 0:
            boxes = Boxes(
                rng.uniform((-1, -1, 0), (1, 1, 1), (BOXES, 3)), half_sizes, rng.uniform(-np.pi, np.pi, BOXES)
            )
            data.mocap_pos[:] = boxes.centres
            data.mocap_quat[:] = np.column_stack(
                (np.cos(boxes.yaws / 2), 0 * boxes.yaws, 0 * boxes.yaws, np.sin(boxes.yaws / 2))
            )
            with_boxes = arm.among(boxes)
        q = rng.uniform(low, high)
        data.qpos[:] = q
        mujoco.mj_kinematics(world, data)
        mujoco.mj_collision(world, data)
        touching = data.contact.geom[data.contact.dist < 0]
        with_box = np.isin(touching, box_geoms).any(axis=-1)
        by_arm.append((not arm.is_free(q), bool((~with_box).any())))
        by_all.append((not with_boxes.is_free(q), len(touching) > 0))
    return Counts(np.array(by_arm)), Counts(np.array(by_all))


def main(robot: str = "ur5", configurations: int = 10_000) -> None:
    """Measure, and print a table."""
    table = Table(
        "", "meshes touch", "capsules touch", "missed by capsules", "free, but not by capsules",
        title=f"{configurations} configurations of {robot}", title_justify="left", box=MARKDOWN,
    )  # fmt: skip
    for label, counts in zip(
        ("itself and the floor", f"{BOXES} boxes too"), measure(robot, configurations), strict=True
    ):
        capsules, meshes = counts.touching.mean(axis=0)
        table.add_row(label, f"{meshes:.1%}", f"{capsules:.1%}", str(counts.missed), f"{counts.over_careful:.1%}")
    Console(width=160).print(table)


if __name__ == "__main__":
    typer.run(main)

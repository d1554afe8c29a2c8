"""Makes the problems of MotionBenchMaker that come with armctl: `python tools/make_motion_bench_maker.py ARCHIVE`.

ARCHIVE is `resources/ur5/problems.tar.bz2` of github.com/KavrakiLab/vamp, or, with `--robot panda_open`,
`resources/panda/problems.tar.bz2`. Boxes stay as they are, also the lid of the box, which is tilted by 45 degrees. An
upright cylinder becomes a square prism with its axis, height and cross-section area, in the yaw of its file. Positions
are in the world's frame, in which the UR5's base is 0.9144 m high and turned by 1.57 rad. The Panda and its scenes are
raised by `RAISED`, as some of them are below its base. The floor at z = 0 is armctl's.

A problem is feasible if the arm is free at the start, and `PathCertificate` finds a path from there to one of the
configurations in the target's pose.
"""

import functools
import multiprocessing
import os
import re
import tarfile
from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pinocchio
import typer
import yaml
from rich.progress import track

from armctl.core.files import write_atomically
from armctl.core.shipped import write_shipped
from armctl.kernels import capsules
from armctl.kinematics import ArmModel, EdgeChecker, MinimumTimePose
from armctl.kinematics.edge_checker import ArmShapes
from armctl.kinematics.records import box_records
from armctl.planning import PathCertificate
from armctl.planning.path_certificate import PathCertificateOptions
from armctl.scene import Boxes
from armctl.tasks.reach.motion_bench_maker import (
    FORMAT,
    ROBOTS,
    SCENES,
    Problems,
    problems_file,
)
from armctl.tasks.reach.obstacles import read_boxes
from armctl.tasks.reach.scenes import ReachScenesOptions

UPRIGHT = 1e-6
"""Largest error of a rotation that is said to be one about the vertical after a tilt."""
CERTIFICATE = PathCertificateOptions(clearance=0.002, checks=200_000)
RAISED = {"ur5_robotiq85": 0.0, "panda_open": 0.6}
"""m: height of the problems' world over the floor, by robot."""
Problem = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Start (dof,) and goal (dof,), rad, and boxes (k, `TILTED_BOX_NUMBERS`)."""


def read_archive(path: Path, joints: tuple[str, ...], raised: float = 0.0) -> dict[tuple[int, int], Problem]:
    """Return the problems of an archive by scene and number, `raised` by some m, rounded as they are observed."""
    documents: dict[tuple[int, int], dict[str, Any]] = {}
    with tarfile.open(path) as archive:
        for member in archive.getmembers():
            match = re.search(r"([a-z_]+)_[a-z0-9]+/(scene|request)(\d+)\.yaml$", member.name)
            if match and (file := archive.extractfile(member)):
                scene, kind, number = match.groups()
                document = yaml.load(file.read(), yaml.CSafeLoader)
                documents.setdefault((SCENES.index(scene), int(number)), {})[kind] = document
    return {
        key: (*request_of(pair["request"], joints), boxes_of(pair["scene"], raised))
        for key, pair in sorted(documents.items())
    }


def request_of(document: dict[str, Any], joints: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return start and goal (dof,) rad of a request."""
    state = document["start_state"]["joint_state"]
    start = dict(zip(state["name"], state["position"], strict=True))
    goal = {of["joint_name"]: of["position"] for of in document["goal_constraints"][0]["joint_constraints"]}
    first, last = (np.array([values[joint] for joint in joints], dtype=np.float32) for values in (start, goal))
    return first, last


def boxes_of(document: dict[str, Any], raised: float = 0.0) -> np.ndarray:
    """Return the objects of a scene, `raised` by some m, as boxes (k, `TILTED_BOX_NUMBERS`)."""
    rows = []
    for thing in document["world"]["collision_objects"]:
        (primitive,), (pose,) = thing["primitives"], thing["primitive_poses"]
        placement = _placement(thing["pose"]) * _placement(pose) if "pose" in thing else _placement(pose)
        sizes = np.array(primitive["dimensions"], dtype=float)
        if primitive["type"] == "cylinder":
            height, radius = sizes
            half_sizes = np.array((*[radius * np.sqrt(np.pi) / 2] * 2, height / 2))
        elif primitive["type"] == "box":
            half_sizes = sizes / 2
        else:
            raise ValueError(f"{thing['id']} is a {primitive['type']}, not a box or a cylinder")
        x, y, z = placement.translation
        rows.append((x, y, z + raised, *half_sizes, *_yaw_and_tilt(placement.rotation)))
    return np.array(rows, dtype=np.float32)


def _placement(pose: dict[str, Any]) -> pinocchio.SE3:
    x, y, z, w = pose["orientation"]
    rotation = pinocchio.Quaternion(w, x, y, z).normalized().matrix()
    return pinocchio.SE3(rotation, np.array(pose["position"], dtype=float))


def _yaw_and_tilt(rotation: np.ndarray) -> tuple[float, float]:
    yaw, tilt = np.arctan2(-rotation[0, 1], rotation[1, 1]), np.arctan2(-rotation[2, 0], rotation[2, 2])
    box = Boxes(np.zeros((1, 3)), np.ones((1, 3)), np.array([yaw]), np.array([tilt]))
    if np.abs(box.rotations[0] - rotation).max() > UPRIGHT:
        raise ValueError(f"a box is turned otherwise than about the vertical after a tilt: {rotation.tolist()}")
    return float(yaw), float(tilt)


@functools.cache
def _tools(robot: str) -> tuple[MinimumTimePose, PathCertificate, ArmShapes]:
    model = ArmModel(robot)
    search = MinimumTimePose(model, ReachScenesOptions().lever)
    return search, PathCertificate(model, CERTIFICATE), ArmShapes(model)


def certified(robot: str, problem: Problem) -> str:
    """Return "feasible", or the reason why a problem is not."""
    search, certificate, shapes = _tools(robot)
    start, goal = (q.astype(float) for q in problem[:2])
    boxes, model = read_boxes(problem[2], problem[2].shape[1]), search.model
    if touched := _contact(model, boxes, start):
        return f"start: {touched}"
    goals = np.vstack((goal, *search.at_centre(start, search.place(goal))))
    if len(certificate.path_to(goals, start, boxes)):
        return "feasible"
    checker = EdgeChecker(shapes, boxes, CERTIFICATE.clearance, start)
    if any(checker.is_free(q) for q in goals):
        return "no path"
    return f"goal: {_contact(model, boxes, goal) or 'too near'}"


def _contact(model: ArmModel, boxes: Boxes, q: np.ndarray) -> str:
    """Return what touches what at `q` (dof,), in words; "" if nothing does."""
    depths = {}
    for i, capsule in enumerate(model.description.capsules):
        depths[capsule.link] = np.full(len(boxes), np.inf)
        capsules.box_distances(model.joints, model.links[i : i + 1], box_records(boxes), q, depths[capsule.link])
    deepest = min(depths, key=lambda link: depths[link].min())
    if depths[deepest].min() <= 0:
        return f"{deepest} in a box"
    return "" if model.is_free(q) else "itself or the floor"


def main(
    archive: Path,
    robot: str = ROBOTS[0],
    out: Path | None = None,
    processes: Annotated[int, typer.Option(min=1)] = os.cpu_count() or 1,
) -> None:
    """Convert and certify an archive's problems, and write them."""
    out = out or problems_file(robot)
    problems = read_archive(archive, ArmModel(robot).description.joints, RAISED[robot])
    with multiprocessing.get_context("spawn").Pool(processes) as workers:
        verdicts = list(
            track(workers.imap(functools.partial(certified, robot), problems.values(), 5), "problems", len(problems))
        )
    scenes, numbers = np.array(list(problems), dtype=np.uint8).T
    starts, goals, boxes = zip(*problems.values(), strict=True)
    converted = Problems(
        scenes=scenes.copy(),
        numbers=numbers.copy(),
        starts=np.array(starts),
        goals=np.array(goals),
        counts=np.array([len(of) for of in boxes], dtype=np.uint8),
        packed=np.concatenate(boxes),
        feasible=np.array([verdict == "feasible" for verdict in verdicts]),
    )
    write_atomically(out, functools.partial(write_shipped, converted, FORMAT))
    print(f"{out}: {out.stat().st_size:,} bytes")
    for i, scene in enumerate(SCENES):
        counts = Counter(verdict for verdict, of in zip(verdicts, scenes, strict=True) if of == i)
        print(f"{scene}: {', '.join(f'{number} {verdict}' for verdict, number in counts.most_common())}")


if __name__ == "__main__":
    typer.run(main)

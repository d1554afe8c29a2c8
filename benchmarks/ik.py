"""Inverse kinematics of full poses: armctl's solvers beside those of others, all judged by one model for each arm.

    python benchmarks/ik.py [--poses 10000] [--peer-poses 500]

The poses are those of random configurations: of a UR5; in the second table, of arms with seven joints, which need the
extra `redundant`. pink and mink know one differential step; here they iterate it as armctl's numeric solver does its
own, with as many starts and steps, and with the damping that suits them best. A pose is solved if a configuration
within the joint limits has the end-effector within 1e-6 m and 1e-6 rad of it, by Pinocchio.
"""

import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from typing import Any

import mink
import numpy as np
import pink
import pinocchio
import typer
from pink.limits import ConfigurationLimit
from printing import progress, show
from rich.box import MARKDOWN
from rich.table import Column, Table

from armctl.core.arrays import Array
from armctl.kinematics import ArmModel, Ik, IkOptions
from armctl.kinematics.ik import _PoseProblem
from armctl.robots import build_arm_world
from armctl.robots.arm import PREFIX

TOLERANCE = 1e-6  # m and rad
PATIENCE = 8  # steps in a row that may fail to take a tenth off the error before a start is given up, as in `Ik`
PEER_DAMPING = 0.02  # times the squared error: of 0 to 1, where pink and mink need the fewest starts
PACKAGES = ("armctl-suite", "eaik", "ssik", "pin", "pin-pink", "mink", "daqp", "mujoco", "numpy")
HEADINGS = (
    *("poses", "solved", "median ms", "mean ms", "p99 ms", "max ms", "solutions a pose"),
    *("largest residual", "unreachable: median ms", "one step, µs"),
)
TRAC_IK = """TRAC-IK's README, UR5 (C++, another machine, to 1e-5 within 5 ms):
99.62 % at a mean of 0.39 ms over the solved (v1.1.0); 99.17 % at a mean of 0.37 ms over all (v1.5.1)."""


@dataclass(frozen=True)
class Peer:
    """pink or mink, whose interfaces are alike, with one task: the end-effector's pose."""

    configuration: Any
    task: Any
    as_target: Callable[[Array], Any]
    velocity: Callable[[Any, list[Any]], Array]


def pink_peer(model: ArmModel) -> Peer:
    return Peer(
        pink.Configuration(model.pinocchio, model.pinocchio.createData(), model.home),
        pink.FrameTask(model.description.tip, 1.0, 1.0, lm_damping=PEER_DAMPING),
        pinocchio.SE3,
        partial(pink.solve_ik, dt=1.0, solver="daqp", limits=[ConfigurationLimit(model.pinocchio)], safety_break=False),
    )


def mink_peer(model: ArmModel) -> Peer:
    world = build_arm_world(model.description, "position")
    return Peer(
        mink.Configuration(world, model.home),
        mink.FrameTask(PREFIX + model.description.tip, "body", 1.0, 1.0, lm_damping=PEER_DAMPING),
        mink.SE3.from_matrix,
        partial(mink.solve_ik, dt=1.0, solver="daqp", limits=[mink.ConfigurationLimit(world)]),
    )


def step_from(peer: Peer, start: Array, pose: Array) -> Callable[[], None]:
    """Return one differential step of a peer, which is left at `start` until the step is called."""
    peer.task.set_target(peer.as_target(pose))
    peer.configuration.update(start)
    return lambda: peer.configuration.integrate_inplace(peer.velocity(peer.configuration, [peer.task]), 1.0)


def iterate(peer: Peer, starts: Array, pose: Array) -> list[Array]:
    """Return the configuration of the first start that ends at the pose, if any does."""
    return next(([peer.configuration.q.copy()] for q in starts if converges(peer, step_from(peer, q, pose))), [])


def converges(peer: Peer, step: Callable[[], None]) -> bool:
    best, stalled = np.inf, 0
    for _ in range(IkOptions().max_iterations):
        error = float(np.linalg.norm(peer.task.compute_error(peer.configuration)))
        stalled = 0 if error < 0.9 * best else stalled + 1
        best = min(best, error)
        if error < TOLERANCE or stalled > PATIENCE:
            break
        step()
    return error < TOLERANCE


def residual(model: ArmModel, q: Array, pose: Array) -> float:
    """Return the larger of position error (m) and rotation angle (rad); infinite outside the joint limits."""
    reached = model.pose(q)
    half_chord = np.linalg.norm(reached[:3, :3] - pose[:3, :3]) / np.sqrt(8)
    angle = 2 * np.arcsin(min(1.0, half_chord))  # unlike the arc cosine of the trace, exact near zero
    return float(max(np.linalg.norm(reached[:3, 3] - pose[:3, 3]), angle)) if model.within_limits(q) else np.inf


def timed(call: Callable[[], Any]) -> tuple[float, Any]:
    start = time.perf_counter()
    value = call()
    return 1e3 * (time.perf_counter() - start), value


def figures(model: ArmModel, name: str, poses: list[Array], solve: Any, prepare_step: Any) -> list[str]:
    """Return a row of the table, for functions from a pose to its solutions and to the first step towards it."""
    times, residuals = [], []
    for pose in progress(poses, name):
        milliseconds, solutions = timed(partial(solve, pose))
        times.append(milliseconds)
        residuals.append([residual(model, q, pose) for q in solutions])
    counts = np.array([sum(error < TOLERANCE for error in of_pose) for of_pose in residuals])
    too_far = [pinocchio.SE3(pose[:3, :3], np.array([2.0, 0, 0])).homogeneous for pose in poses[:50]]
    steps = [timed(prepare_step(pose))[0] for pose in poses[:500]] if prepare_step else []
    return [
        name,
        f"{len(poses):,}",
        f"{np.mean(counts > 0):.2%}",
        *(f"{figure:.3f}" for figure in (np.median(times), np.mean(times), np.percentile(times, 99), max(times))),
        f"{counts.mean():.2f}",
        f"{max((error for of_pose in residuals for error in of_pose), default=np.nan):.1e}",
        f"{np.median([timed(partial(solve, pose))[0] for pose in too_far]):.2f}",
        f"{1e3 * np.median(steps):.0f}" if steps else "-",
    ]


def figures_of(robot: str, poses: int, rng: np.random.Generator) -> list[str]:
    """Return a row for an arm of seven joints, by its closed form."""
    model = ArmModel(robot)
    ik = Ik(model)
    targets = [model.pose(q) for q in model.random_configurations(rng, poses)]
    ik.pose(targets[0])  # loads ssik
    return figures(model, robot, targets, lambda pose: ik.pose(pose).solutions, None)


def main(poses: int = 10_000, peer_poses: int = 500) -> None:
    """Measure, and print one table."""
    model, rng = ArmModel("ur5"), np.random.default_rng(0)
    targets = [model.pose(q) for q in rng.uniform(-np.pi, np.pi, (poses, model.dof))]
    starts = np.vstack([model.home, rng.uniform(-np.pi, np.pi, (IkOptions().starts, model.dof))])
    closed_form, numeric, single_step = Ik(model), Ik(model), Ik(model, IkOptions(max_iterations=1))
    numeric.closed_form = None  # as for an arm without a closed form

    def own_step(pose: Array) -> Callable[[], Any]:
        return partial(single_step._polish, _PoseProblem(model, pose), model.home)

    table = Table("", *(Column(heading, justify="right") for heading in HEADINGS), box=MARKDOWN)
    table.add_row(*figures(model, "armctl, closed form", targets, lambda pose: closed_form.pose(pose).solutions, None))
    eaik, exact = closed_form.closed_form, lambda q, approximate: q[~approximate]
    table.add_row(*figures(model, "EAIK alone", targets, lambda pose: exact(*eaik(pose)), None))
    table.add_row(*figures(model, "armctl, numeric", targets, lambda pose: numeric.pose(pose).solutions, own_step))
    for name, peer in (("pink", pink_peer(model)), ("mink", mink_peer(model))):
        solve, prepare_step = partial(iterate, peer, starts), partial(step_from, peer, model.home)
        table.add_row(*figures(model, name, targets[:peer_poses], solve, prepare_step))

    seven_joints = Table("", *(Column(heading, justify="right") for heading in HEADINGS), box=MARKDOWN)
    for robot in ("panda", "xarm7"):
        seven_joints.add_row(*figures_of(robot, poses, rng))

    versions = ", ".join(f"{package} {version(package)}" for package in PACKAGES)
    machine = f"{os.cpu_count()} cores, Python {platform.python_version()}, {versions}"
    show(machine, table, TRAC_IK, seven_joints, width=200)  # all columns, also where the output is no terminal


if __name__ == "__main__":
    typer.run(main)

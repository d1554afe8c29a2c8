"""Closed forms of inverse kinematics, from the libraries that have them.

EAIK solves arms of six joints with a known geometric decomposition, all UR among them (Ostermeier, Kuelz and Althoff,
"Automatic geometric decomposition for analytical inverse kinematics", RA-L 2025). ssik, if it is installed (extra
`redundant`), solves the Panda and the xArm7, whose seven joints leave a circle of configurations for each branch: it
samples that.
"""

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import eaik.pybindings.EAIK as eaik
import numpy as np
import pinocchio
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels import ik as kernel
from armctl.kinematics.model import ArmModel

ClosedForm = Callable[[Array], tuple[Array, NDArray[np.bool_]]]
"""Function of a pose (4, 4) that gives configurations (k, dof), and whether each is an approximation, (k,)."""

PREBUILT = {"panda": "franka_panda", "panda_open": "franka_panda", "UF_ROBOT": "xarm7"}
"""Robots that ssik knows, by the names in their URDF files."""
SAME = 1e-9
"""m: largest difference between two models of one arm."""
NO_SOLUTION = np.empty((0, 6))
"""Configurations where there is none: EAIK's array is (0, 0)."""
DIGITS = 4
"""Decimal places (m) of arms' dimensions: what is beyond comes from angles that are rounded in their files."""


def six_joints(model: ArmModel) -> ClosedForm | None:
    """Return EAIK's closed form for the arm, or None if it has no decomposition for it."""
    if model.dof != 6 or model.description.sliding or model.description.followers:
        return None
    origins = [np.zeros(3)]
    axes = []
    data = model.pinocchio.createData()
    pinocchio.computeJointJacobians(model.pinocchio, data, np.zeros(6))
    for i in range(6):
        axes.append(pinocchio.getJointJacobian(model.pinocchio, data, i + 1, pinocchio.LOCAL_WORLD_ALIGNED)[3:, i])
        origins.append(data.oMi[i + 1].translation.copy())
    zero_pose = model.pose(np.zeros(6))
    offsets = np.diff([*origins, zero_pose[:3, 3]], axis=0)
    solver = eaik.Robot(np.transpose(axes), offsets.T, zero_pose[:3, :3], [], True)
    if not solver.has_known_decomposition():
        return None

    def solve(pose: Array) -> tuple[Array, NDArray[np.bool_]]:
        solution = solver.calculate_IK(pose)
        q = solution.Q
        return q if len(q) else NO_SOLUTION, solution.is_LS

    return solve


def seven_joints(model: ArmModel) -> ClosedForm | None:
    """Return ssik's closed form for the arm; None if ssik is not installed, or does not know the arm."""
    name = PREBUILT.get(model.description.name)
    solver = _ssik(name) if name else None
    if solver is None or solver.dof != model.dof or model.description.followers:
        return None
    mount = model.pinocchio.jointPlacements[1].homogeneous @ np.linalg.inv(solver.kinbody.joints[0].T_left)
    to_tip = np.linalg.inv(mount @ solver.fk(model.home)) @ model.pose(model.home)
    samples = model.random_configurations(np.random.default_rng(0), 20)
    if max(np.abs(mount @ solver.fk(q) @ to_tip - model.pose(q)).max() for q in samples) > SAME:
        return None
    from_mount, from_tip, branches = np.linalg.inv(mount), np.linalg.inv(to_tip), _branches(solver)

    def solve(pose: Array) -> tuple[Array, NDArray[np.bool_]]:
        solutions = branches(from_mount @ pose @ from_tip)
        kernel.refine(model.joints, pose, solutions)
        return solutions, np.zeros(len(solutions), dtype=bool)

    return solve


def _branches(arm: Any) -> Callable[[Array], Array]:
    """Return the function from a pose of ssik's arm to configurations (k, dof) nearer to it than `kernel.refine` needs.

    Axes that meet in a real arm miss each other by micrometres where its file has rounded angles, and ssik then
    improves each configuration numerically. Those of the arm with axes that meet need no more than `kernel.refine`.
    """
    try:
        from ssik import Manipulator, _ssik_native, cpp

        data, links = cpp.solver_data(arm), arm.kinbody
        joints = [
            replace(joint, **{name: np.round(getattr(joint, name), DIGITS) for name in ("axis", "T_left", "T_right")})
            for joint in links.joints
        ]
        exact = Manipulator(replace(links, joints=joints))
        if arm.solver_name == f"{exact.solver_name}_polished":
            data = replace(cpp.solver_data(exact), family=arm.solver_name)
        # The compiled solver's arguments: pose, within limits, no seed, no limit on their number, and single turns.
        options = (1, False, np.zeros(0), "wrap_linf", False, 0.0, -1, True, 15, False)
        solver = functools.partial(_compiled_branches, _ssik_native.Solver(data), options, arm.dof)
        solver(arm.fk(np.zeros(arm.dof)))
    except (ImportError, AttributeError, TypeError):  # no compiled solver, or another version's
        return lambda pose: _as_rows([each.q for each in arm.solve(pose, enumerate_windings=False)], arm.dof)
    return solver


def _compiled_branches(solver: Any, options: tuple[Any, ...], dof: int, pose: Array) -> Array:
    return _as_rows(solver.solve(pose, *options)[0], dof)


def _as_rows(q: Any, dof: int) -> Array:
    return np.array(q, dtype=float).reshape(-1, dof)


@functools.cache
def _ssik(name: str) -> Any:
    """Return ssik's solver for an arm; loading it takes seconds."""
    try:
        import ssik
    except ImportError:
        return None
    return ssik.Manipulator.from_prebuilt(name)

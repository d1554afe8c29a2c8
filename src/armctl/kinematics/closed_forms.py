"""Closed forms of inverse kinematics, from the libraries that have them.

EAIK solves arms of six joints with a known geometric decomposition, all UR among them (Ostermeier, Kuelz and Althoff,
"Automatic geometric decomposition for analytical inverse kinematics", RA-L 2025). ssik, if it is installed (extra
`redundant`), solves the Panda and the xArm7, whose seven joints leave a circle of configurations for each branch: it
samples that.
"""

import functools
from collections.abc import Callable
from typing import Any

import eaik.pybindings.EAIK as eaik
import numpy as np
import pinocchio
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kinematics.model import ArmModel

ClosedForm = Callable[[Array], tuple[Array, NDArray[np.bool_]]]
"""Function of a pose (4, 4) that gives configurations (k, dof), and whether each is an approximation, (k,)."""

PREBUILT = {"panda": "franka_panda", "UF_ROBOT": "xarm7"}
"""Robots that ssik knows, by the names in their URDF files."""
SAME = 1e-9
"""m: largest difference between two models of one arm."""


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
        return np.reshape(solution.Q, (-1, 6)), solution.is_LS  # EAIK's empty one is (0, 0)

    return solve


def seven_joints(model: ArmModel) -> ClosedForm | None:
    """Return ssik's closed form for the arm; None if ssik is not installed, or does not know the arm."""
    name = PREBUILT.get(model.description.name)
    solver = _ssik(name) if name else None
    if solver is None or solver.dof != model.dof or model.description.followers:
        return None
    to_tip = np.linalg.inv(solver.fk(model.home)) @ model.pose(model.home)
    samples = model.random_configurations(np.random.default_rng(0), 20)
    if max(np.abs(solver.fk(q) @ to_tip - model.pose(q)).max() for q in samples) > SAME:
        return None
    from_tip = np.linalg.inv(to_tip)

    def solve(pose: Array) -> tuple[Array, NDArray[np.bool_]]:
        solutions = [solution.q for solution in solver.solve(pose @ from_tip, enumerate_windings=False)]
        return np.array(solutions, dtype=float).reshape(-1, model.dof), np.zeros(len(solutions), dtype=bool)

    return solve


@functools.cache
def _ssik(name: str) -> Any:
    """Return ssik's solver for an arm; loading it takes seconds."""
    try:
        import ssik
    except ImportError:
        return None
    return ssik.Manipulator.from_prebuilt(name)

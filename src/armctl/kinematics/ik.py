"""Inverse kinematics: configurations with the end-effector at a pose or a position, with their residuals.

Poses are solved in closed form for the arms of `closed_forms`. Everything else, and arms whose closed form does not
find what they reach (two joints about one axis, say), is solved by Levenberg-Marquardt with error-proportional damping
(Sugihara, "Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt method", T-RO 2011) from several
starts.
"""

import functools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
import pinocchio
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError, UnreachableTarget
from armctl.core.options import Count, Natural, NonNegative, Positive, options
from armctl.kernels import ik as kernel
from armctl.kinematics.closed_forms import ClosedForm, seven_joints, six_joints
from armctl.kinematics.damped_least_squares import damped_step
from armctl.kinematics.model import ArmModel

RIGID = 1e-6
"""Tolerance on the entries of a rotation times its transpose."""
EXACT = 0.01
"""Fraction of the tolerance below which a residual is not improved any more."""


OWN_POSITIONS = 8
"""Positions on which a closed form is tried."""


@options
class IkOptions:
    """Bounds of a search."""

    tolerance: Positive = 1e-6
    """Largest residual of a solution: norm of the position error (m), or of the pose's twist (m and rad)."""
    max_iterations: Count = 60
    """Levenberg-Marquardt steps from one start."""
    starts: Count = 24
    """Random starts of a numeric search, after the seed and home."""
    damping: NonNegative = 0.02
    """Levenberg-Marquardt damping per squared unit of residual."""
    rng_seed: Natural = 0
    """Seed of the random starts: a search depends only on its arguments."""
    near: NonNegative = 0.1
    """Residual below which the seed is polished too: singular poses have more solutions than a closed form gives."""
    distinct: NonNegative = 1e-3
    """Configurations closer than this in every joint (rad) count as one solution."""


class IkResult(NamedTuple):
    """Solutions within the joint limits, the one nearest to the seed first."""

    configurations: Array
    """(max(k, 1), dof) rad: the k solutions; if there is none, the configuration with the least residual, inside the
    limits or outside. Of several that are exact, it is the nearest to the seed."""
    configuration_residuals: Array
    """(max(k, 1),) measured by forward kinematics, in the unit of `IkOptions.tolerance`."""
    num_solutions: int
    """k: 0 if the target is out of reach."""
    iterations: int

    @property
    def solutions(self) -> Array:
        """The solutions, (k, dof) rad."""
        return self.configurations[: self.num_solutions]

    @property
    def residuals(self) -> Array:
        """The residuals of the solutions, (k,)."""
        return self.configuration_residuals[: self.num_solutions]

    @property
    def closest(self) -> Array:
        """The first solution, or what comes nearest to one, (dof,) rad."""
        return np.asarray(self.configurations[0])

    @property
    def closest_residual(self) -> float:
        """The residual of `closest`."""
        return float(self.configuration_residuals[0])

    @property
    def reachable(self) -> bool:
        """True if there is a solution."""
        return self.num_solutions > 0

    @property
    def q(self) -> Array:
        """The solution nearest to the seed, (dof,) rad. Raises `UnreachableTarget` if there is none."""
        if not self.reachable:
            raise UnreachableTarget(
                f"no configuration reaches the target; the closest is off by {self.closest_residual:.3g}"
            )
        return self.closest


def random_orientations(n: int, rng: np.random.Generator) -> Array:
    """Return uniform rotation matrices, (n, 3, 3): those of `scipy.spatial.transform`, which takes long to import."""
    x, y, z, w = rng.normal(size=(n, 4)).T
    x, y, z, w = np.array((x, y, z, w)) / np.sqrt(x * x + y * y + z * z + w * w)
    xy, xz, xw, yz, yw, zw = x * y, x * z, x * w, y * z, y * w, z * w
    columns = (
        (x * x - y * y - z * z + w * w, 2 * (xy + zw), 2 * (xz - yw)),
        (2 * (xy - zw), -x * x + y * y - z * z + w * w, 2 * (yz + xw)),
        (2 * (xz + yw), 2 * (yz - xw), -x * x - y * y + z * z + w * w),
    )
    return np.array(columns).transpose(2, 1, 0).copy()


class Ik:
    """Inverse kinematics of one arm."""

    def __init__(self, model: ArmModel, options: IkOptions | None = None) -> None:
        self.model = model
        self.options = options or IkOptions()
        self._tolerances = EXACT * self.options.tolerance, self.options.near, self.options.distinct
        self._six_joints = six_joints(model)
        """The closed form for positions as well, if it is of use for them."""
        rng = np.random.default_rng(self.options.rng_seed)
        self._random_starts = model.random_configurations(rng, self.options.starts)
        self._orientations = random_orientations(self.options.starts, rng)
        self._full_turn = model.limits.upper - model.limits.lower >= 2 * np.pi - 1e-6
        if self._six_joints is not None and not self._reaches_own_positions():
            self._six_joints = None

    @functools.cached_property
    def closed_form(self) -> ClosedForm | None:
        """The closed form for poses, if the arm has one."""
        return self._six_joints or seven_joints(self.model)

    def pose(self, target: Array, seed: Array | None = None, count: int | None = None) -> IkResult:
        """Return up to `count` configurations for a full pose, homogeneous (4, 4), the nearest to `seed` (dof,) first.

        The closed form gives all solutions (up to 8 for a UR). The numeric search stops at `count` (default 1).
        Raises `ConfigurationError` if `target` is not a rigid transform.
        """
        target = np.ascontiguousarray(target, dtype=float)
        if target.shape != (4, 4) or not kernel.is_rigid(target, RIGID):
            raise ConfigurationError(f"pose should be a homogeneous (4, 4) matrix with a proper rotation, not {target}")
        seed = self._checked(seed, count)
        if self.closed_form is None:
            return self._search(_PoseProblem(self.model, target), seed, count or 1)
        q, approximate = self.closed_form(target)
        return self._chosen(target, q, approximate, seed, count) or self._polished(target, q, approximate, seed, count)

    def follow(self, target: Array, seed: Array) -> IkResult:
        """Return the configuration for a pose (4, 4) to which the numeric search leads from `seed` (dof,) alone.

        It needs no closed form, and so is the same with whatever is installed.
        """
        return self._result([self._polish(_PoseProblem(self.model, target), self._checked(seed, 1))], seed, 1)

    def _chosen(
        self, target: Array, q: Array, approximate: NDArray[np.bool_], seed: Array, count: int | None
    ) -> IkResult | None:
        """Return the closed form's solutions; None if one of them needs to be polished, or there is none."""
        configurations, residuals = np.empty(q.shape), np.empty(len(q))
        number = kernel.choose(
            self.model.joints, target, q, approximate, seed, self._tolerances, configurations, residuals
        )
        if number == kernel.NOT_ENOUGH:
            return None
        if count is not None:
            number = min(number, count)
        if number < len(q):
            rows = max(number, 1)
            configurations, residuals = configurations[:rows], residuals[:rows]
        return IkResult(configurations, residuals, number, 0)

    def _polished(
        self, target: Array, q: Array, approximate: NDArray[np.bool_], seed: Array, count: int | None
    ) -> IkResult:
        """Return the closed form's solutions, or its approximations if there are none, improved numerically."""
        problem = _PoseProblem(self.model, target)
        starts = list(q if approximate.all() else q[~approximate])
        if np.linalg.norm(problem.error(seed)) < self.options.near:
            starts.append(seed)
        return self._result([self._polish(problem, start) for start in starts], seed, count)

    def position(self, target: Array, seed: Array | None = None, count: int = 1) -> IkResult:
        """Return up to `count` distinct configurations for a position (3,) m, the nearest to `seed` (dof,) first.

        Raises `ConfigurationError` if `target` is not three finite numbers.
        """
        target = np.asarray(target, dtype=float)
        if target.shape != (3,) or not np.isfinite(target).all():
            raise ConfigurationError(f"position should be three finite numbers, not {target}")
        seed = self._checked(seed, count)
        return self._search(_PositionProblem(self.model, target), seed, count)

    def free_configurations(self, position: Array) -> Iterator[Array]:
        """Return collision-free configurations (dof,) at `position` (3,).

        These are not all, but the same every time: a fixed set of orientations (or of numeric starts) is tried, with
        what the core of armctl installs.
        """
        for q in self.configurations(position):
            yield from q[self.model.are_usable(q)]

    def configurations(self, position: Array) -> Iterator[Array]:
        """Yield the same in groups (k, dof), in collision or not; joints may exceed their limits by whole turns."""
        if self._six_joints is None:
            yield self.position(position, count=self.options.starts).solutions
            return
        pose = np.eye(4)
        pose[:3, 3] = position
        for orientation in self._orientations:
            pose[:3, :3] = orientation
            q, approximate = self._six_joints(pose)
            yield q[~approximate]

    def exact(self, pose: Array) -> Array | None:
        """Return the closed form's configurations (k, dof) for a pose (4, 4), in collision or not, near home.

        None if the arm has no closed form that the core of armctl installs.
        """
        if self._six_joints is None:
            return None
        q, approximate = self._six_joints(pose)
        return self.model.nearest_turn(q[~approximate], self.model.home)

    def _reaches_own_positions(self) -> bool:
        """Return True if `configurations` finds most of some positions where the arm can be."""
        positions = self.model.positions(self._random_starts[:OWN_POSITIONS])
        reached = [
            any(len(q) and self.model.within_limits(q).any() for q in self.configurations(at)) for at in positions
        ]
        return 2 * sum(reached) > len(reached)

    def _checked(self, seed: Array | None, count: int | None) -> Array:
        if count is not None and count < 1:
            raise ConfigurationError(f"count should be at least 1, not {count}")
        if seed is None:
            return self.model.home
        seed = np.asarray(seed, dtype=float)
        if seed.shape != (self.model.dof,) or not np.isfinite(seed).all():
            raise ConfigurationError(f"seed should be {self.model.dof} finite joint positions, not {seed}")
        return np.clip(seed, self.model.limits.lower, self.model.limits.upper)

    def _search(self, problem: "_Problem", seed: Array, count: int) -> IkResult:
        """Try one start after the other until there are `count` solutions."""
        attempts: list[_Attempt] = []
        home = [] if np.array_equal(seed, self.model.home) else [self.model.home]
        for start in (seed, *home, *self._random_starts):
            attempts.append(self._polish(problem, start))
            if attempts[-1].residual <= self.options.tolerance:
                result = self._result(attempts, seed, count)
                if len(result.solutions) == count:
                    return result
        return self._result(attempts, seed, count)

    def _polish(self, problem: "_Problem", q: Array) -> "_Attempt":
        """Make Levenberg-Marquardt steps from `q` until the tolerance is met or the residual stalls."""
        best, best_residual, stalled = q, np.inf, 0
        for step in range(self.options.max_iterations):  # noqa: B007
            error = problem.error(q)
            residual = math.sqrt(error @ error)
            stalled = 0 if residual < 0.9 * best_residual else stalled + 1
            if residual < best_residual:
                best, best_residual = q, residual
            if residual < EXACT * self.options.tolerance or stalled > 8:
                break
            q = q - damped_step(problem.jacobian(q), error, self.options.damping * residual**2 + 1e-9)
            q = np.where(self._full_turn, q, np.clip(q, self.model.limits.lower, self.model.limits.upper))
        return _Attempt(best, best_residual, step)

    def _result(self, attempts: "list[_Attempt]", seed: Array, count: int | None) -> IkResult:
        if not attempts:
            return IkResult(seed[None], np.array([np.inf]), 0, 0)
        q = self.model.nearest_turn(np.array([attempt.q for attempt in attempts]), seed)
        residuals = np.array([attempt.residual for attempt in attempts])
        by_distance = np.argsort(np.abs(q - seed).max(axis=-1), kind="stable")
        allowed = (residuals <= self.options.tolerance) & self.model.within_limits(q)
        order = by_distance[allowed[by_distance]]
        apart = np.abs(q[order][:, None] - q[order]).max(axis=-1) > self.options.distinct
        order = order[np.all(apart | ~np.tri(len(order), k=-1, dtype=bool), axis=1)][:count]
        inexact = np.maximum(residuals[by_distance], EXACT * self.options.tolerance)
        rows = order if len(order) else by_distance[[np.argmin(inexact)]]
        return IkResult(q[rows], residuals[rows], len(order), sum(attempt.iterations for attempt in attempts))


@dataclass(frozen=True)
class _Attempt:
    q: Array
    residual: float
    iterations: int


class _Problem(Protocol):
    """An error (m,) to bring to zero, and its derivative by q, (m, dof)."""

    def error(self, q: Array) -> Array: ...
    def jacobian(self, q: Array) -> Array: ...


class _PositionProblem:
    def __init__(self, model: ArmModel, target: Array) -> None:
        self.model, self.target = model, target

    def error(self, q: Array) -> Array:
        return self.target - self.model.position(q)

    def jacobian(self, q: Array) -> Array:
        return -self.model.jacobian(q)[:3]


class _PoseProblem:
    """The twist (linear m, angular rad) from the end-effector to the target pose, in the end-effector's frame."""

    def __init__(self, model: ArmModel, target: Array) -> None:
        self.model, self.target = model, pinocchio.SE3(target)

    def error(self, q: Array) -> Array:
        return np.array(pinocchio.log6(self.model.placement(q).actInv(self.target)))

    def jacobian(self, q: Array) -> Array:
        error = self.model.placement(q).actInv(self.target)
        return np.asarray(-pinocchio.Jlog6(error.inverse()) @ self.model.local_jacobian(q))

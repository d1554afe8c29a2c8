"""Linearisation of a `ReachProblem` as a sparse quadratic program with a fixed sparsity pattern.

    minimise  x' P x / 2 + q' x   subject to  l <= A x <= u

The unknowns of the knots k = 1..N are joint positions q_k, displacements per period v_k T (so that all are angles of
similar size), and the slack of the obstacle constraints of knot k. A solver factors the pattern once. Then only numbers
change: the Hessian's blocks of each q_k, the gradient, the bounds, and the normals of obstacles.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from armctl.control.reach_problem import JointTrajectory, OcpParameters, ReachProblem, stopping_times
from armctl.core.arrays import Array
from armctl.kernels import reach_mpc as kernel
from armctl.robot_description import JointLimits

Integers = NDArray[np.int64]

SLACK_CURVATURE = 10.0
"""Weight of the squared slack, beside the linear penalty: the solver converges faster with it."""
ACCELERATION, VELOCITY, POSITION, CLEARANCE = 20.0, 3.0, 0.1, 3.0
"""Row scales: an operator-splitting solver needs larger steps for stiffer rows. An acceleration moves all later knots,
so the cost's curvature in it is thousands of times that in the last knot's position."""
_MARK = 1e9
"""Placeholder above all numbers of the matrix, for entries that will be written."""


class ReachQp:
    """Writes quadratic programs: `write`, then read `hessian` (upper triangle), `gradient`, `matrix`, `lower`, `upper`.

    Each knot has `rows` obstacle constraints, with `slack_penalty` per m of violation.
    """

    def __init__(self, problem: ReachProblem, limits: JointLimits, rows: int, slack_penalty: float) -> None:
        self.problem, self.limits, self.rows = problem, limits, rows
        self.dof = len(limits.lower)
        self.states = problem.horizon * self.dof
        self.hessian, self._blocks = self._hessian_pattern()
        self.matrix, self._obstacles = self._matrix_pattern()
        self.gradient = np.zeros(self.hessian.shape[0])
        self.gradient[2 * self.states :] = slack_penalty
        self._bounds = self._constant_bounds()
        self.lower, self.upper = self._bounds

    def write(self, parameters: OcpParameters, braking: JointTrajectory, hessians: Array, gradients: Array) -> None:
        """Write the program; positions cost q_k' H q_k / 2 + g q_k, with H (N, dof, dof) and g (N, dof).

        `braking` is the worst case: where it violates limits, the plan may too, but not by more.
        """
        problem, limits, states, dof = self.problem, self.limits, self.states, self.dof
        kernel.write_positions_cost(hessians, gradients, *self._blocks, self.hessian.data, self.gradient)
        displacement = parameters.velocity * problem.period
        self.gradient[states : states + dof] = -2 * problem.acceleration / problem.period**4 * displacement
        self.lower, self.upper = lower, upper = self._bounds[0].copy(), self._bounds[1].copy()
        lower[:dof] = upper[:dof] = parameters.position + displacement / 2
        for bound in (lower, upper):
            bound[states : states + dof] += ACCELERATION * displacement
        if np.any(np.abs(parameters.velocity) > limits.velocity):
            displacements = VELOCITY * problem.period * braking.velocities[1:].ravel()
            velocity = slice(2 * states, 3 * states)
            lower[velocity] = np.minimum(lower[velocity], displacements)
            upper[velocity] = np.maximum(upper[velocity], displacements)
        if np.any((braking.positions < limits.lower) | (braking.positions > limits.upper)):
            stops = POSITION * np.concatenate((braking.positions[1:].ravel(), braking.positions[-1]))
            position = slice(3 * states, 4 * states + dof)
            lower[position], upper[position] = np.minimum(lower[position], stops), np.maximum(upper[position], stops)

    def write_obstacles(self, q: Array, distances: Array, normals: Array, margin: float) -> None:
        """Write the constraints distances (N, rows) + normals (N, rows, dof) @ (q_k - q) >= margin, m."""
        kernel.write_obstacles(distances, normals, q, margin, CLEARANCE, self._obstacles, self.matrix.data, self.lower)

    def first_duals(self) -> Array:
        """Return initial multipliers of all rows: zero except for those of the slacks."""
        duals = np.zeros(self.matrix.shape[0])
        if self.rows:
            duals[-self.problem.horizon :] = -self.gradient[-1]
        return duals

    def shift(self, duals: Array) -> None:
        """Shift multipliers by a period, in place: each knot takes over those of the next."""
        knots, begin = self.problem.horizon, self._obstacles.begin
        parts = [duals[: 4 * self.states].reshape(4, knots, -1)]
        if self.rows:
            parts += [duals[begin:-knots].reshape(1, knots, -1), duals[-knots:].reshape(1, knots, -1)]
        for part in parts:
            part[:, :-1] = part[:, 1:]

    def _hessian_pattern(self) -> tuple[Any, tuple[Integers, Integers, Integers, Integers]]:
        """Return P, and the places of the blocks' entries: in its data, and by knot, row and column."""
        problem, dof, knots = self.problem, self.dof, self.problem.horizon
        velocity, acceleration = 2 * problem.velocity / problem.period**2, 2 * problem.acceleration / problem.period**4
        changes = np.append(np.full(knots - 1, 2.0), 1.0)
        rates: Any = sparse.diags_array(
            [velocity + acceleration * changes, np.full(knots - 1, -acceleration)], offsets=[0, 1]
        )
        blocks = sparse.kron(sparse.eye_array(knots), np.triu(np.full((dof, dof), _MARK)))
        parts: list[Any] = [blocks, sparse.kron(rates, sparse.eye_array(dof))]
        if self.rows:
            parts.append(2 * SLACK_CURVATURE * sparse.eye_array(knots))
        hessian = _compressed(sparse.block_diag(parts))
        marked = np.flatnonzero(hessian.data == _MARK)
        row = hessian.indices[marked]
        column = np.repeat(np.arange(hessian.shape[1]), np.diff(hessian.indptr))[marked]
        hessian.data[marked] = row == column
        return hessian, (marked, row // dof, row % dof, column % dof)

    def _matrix_pattern(self) -> tuple[Any, kernel.Entries]:
        """Return A, and the places of the obstacles' constraints in it."""
        dof, knots, rows = self.dof, self.problem.horizon, self.rows
        eye = sparse.eye_array(self.states)
        previous = sparse.eye_array(self.states, k=-dof)
        last = sparse.eye_array(dof, self.states, k=self.states - dof)
        times = sparse.diags_array(stopping_times(self.limits) / self.problem.period)
        blocks: list[list[Any]] = [
            [eye - previous, -0.5 * (eye + previous)],  # dynamics
            [None, ACCELERATION * (eye - previous)],
            [None, VELOCITY * eye],
            [POSITION * eye, None],
            [POSITION * last, POSITION * times @ last],  # the stop after the last
        ]
        if rows:
            marks = _MARK * (1 + np.arange(knots * rows * dof).reshape(knots, rows, dof))
            blocks = [[*block, None] for block in blocks]
            blocks.append(
                [
                    sparse.block_diag(list(marks)),
                    None,
                    CLEARANCE * sparse.kron(sparse.eye_array(knots), np.ones((rows, 1))),
                ]
            )
            blocks.append([None, None, sparse.eye_array(knots)])
        matrix = _compressed(sparse.block_array(blocks))
        marked = np.flatnonzero(matrix.data >= _MARK)
        order = np.rint(matrix.data[marked] / _MARK).astype(int) - 1
        matrix.data[marked] = 0.0
        return matrix, kernel.Entries(marked, order, 4 * self.states + self.dof)

    def _constant_bounds(self) -> tuple[Array, Array]:
        limits, knots, period = self.limits, self.problem.horizon, self.problem.period
        zero = np.zeros(self.dof)
        change, step = ACCELERATION * limits.acceleration * period**2, VELOCITY * limits.velocity * period

        def bounds(position: Array, sign: float, nearness: float, slack: float) -> Array:
            each = [np.tile(row, knots) for row in (zero, sign * change, sign * step, POSITION * position)]
            free = [np.full(knots * self.rows, nearness), np.full(knots if self.rows else 0, slack)]
            return np.concatenate([*each, POSITION * position, *free])

        return bounds(limits.lower, -1, -np.inf, 0.0), bounds(limits.upper, 1, np.inf, np.inf)


def _compressed(pattern: Any) -> Any:
    """Return a matrix as OSQP takes it without copying: sorted columns without zeros, and 32-bit indices."""
    matrix = sparse.csc_matrix(pattern)
    matrix.eliminate_zeros()
    matrix.sort_indices()
    matrix.indices, matrix.indptr = matrix.indices.astype(np.int32), matrix.indptr.astype(np.int32)
    return matrix

"""Decision time of the arm's model-predictive controller by solver, and distance of its plans from the best.

    python benchmarks/mpc.py [--states 200] [--repeats 5]

The controller reaches for random targets from home, every third of which moves, in closed loop with its own plans. Each
plan is held against the same problem solved to convergence from it on (CasADi and IPOPT), both by the exact nonlinear
cost, after both were made to keep all limits. Then other solvers get the quadratic programs of those decisions. All
times are the least of several runs, for other work on a machine shows in one.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import typer
from printing import markdown_table, progress, show
from reach_reference import ReachReference

from armctl.control.reach_mpc import ReachMpc, ReachMpcOptions
from armctl.control.reach_problem import MpcResult
from armctl.control.reach_qp import ReachQp
from armctl.core.arrays import Array
from armctl.kinematics import ArmModel, Ik
from armctl.scene import Boxes

DECISIONS = 25
"""Decisions in an episode: most are there after 15."""
AMPLITUDE, RATE = 0.1, 2.0
"""m and rad/s of targets that swing to and fro."""
BOXES = Boxes(np.array([[0.5, -0.3, 0.25], [-0.45, 0.35, 0.3], [0.1, 0.6, 0.15]]), np.full((3, 3), 0.08), np.zeros(3))


@dataclass
class Program:
    """A quadratic program, and where its solver began."""

    hessian: Any
    gradient: Array
    matrix: Any
    lower: Array
    upper: Array
    start: Array
    duals: Array


@dataclass
class Run:
    """Record of a closed loop."""

    situations: list[tuple[Any, ...]] = field(default_factory=list)
    plans: list[MpcResult] = field(default_factory=list)
    programs: list[Program] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)


def episodes(model: ArmModel) -> Iterator[tuple[Array, Array, Array]]:
    """Yield targets (3,) m, how they swing, (3,) m, and a posture (dof,) that reaches them."""
    rng, ik, count = np.random.default_rng(0), Ik(model), 0
    while True:
        q = rng.uniform(-np.pi, np.pi, model.dof)
        if not model.is_free(q):
            continue
        target = model.position(q)
        goals = np.array(list(ik.free_configurations(target))).reshape(-1, model.dof)
        if len(goals):
            goals = model.nearest_turn(goals, model.home)
            count += 1
            swing = AMPLITUDE * (count % 3 == 0) * rng.normal(size=3)
            yield target, swing, goals[np.argmin(model.min_time(model.home, goals))]


def drive(model: ArmModel, options: ReachMpcOptions, states: int, record: bool = False) -> Run:
    """Run a closed loop of that many decisions, in which the joints do what was planned."""
    mpc, run = ReachMpc(model, options), Run()
    if record:
        mpc._unconstrained.solve = recorder(mpc._unconstrained.qp, mpc._unconstrained.solve, run.programs)
    horizon, period = options.problem.horizon, options.problem.period
    for target, swing, posture in episodes(model):
        mpc.reset()
        q, v = model.home, np.zeros(model.dof)
        for k in range(DECISIONS):
            times = period * np.arange(k + 1, k + horizon + 1)
            targets = target + np.sin(RATE * times)[:, None] * swing
            plan = mpc.plan(q, v, targets, posture)
            run.situations.append((q, v, targets, posture))
            run.plans.append(plan)
            run.seconds.append(plan.seconds)
            if len(run.plans) == states:
                return run
            q, v = plan.positions[1], plan.velocities[1]
    raise AssertionError("episodes never end")


def recorder(qp: ReachQp, solve: Callable[..., Any], programs: list[Program]) -> Callable[..., Any]:
    def recorded(start: Array, duals: Array) -> Any:
        programs.append(
            Program(qp.hessian.copy(), qp.gradient.copy(), qp.matrix, qp.lower, qp.upper, start, duals.copy())
        )
        return solve(start, duals)

    return recorded


def osqp_solver(first: Program, options: ReachMpcOptions) -> Callable[[Program], Array]:
    import osqp

    solver = osqp.OSQP()
    solver.setup(
        first.hessian, first.gradient, first.matrix, first.lower, first.upper,
        verbose=False, polishing=False, scaling=0, adaptive_rho=False, rho=options.step_size, alpha=1.8,
        eps_abs=options.tolerance, eps_rel=options.tolerance, max_iter=options.max_iterations, check_termination=5,
    )  # fmt: skip

    def solve(program: Program) -> Array:
        solver.update(Px=program.hessian.data, q=program.gradient, l=program.lower, u=program.upper)
        solver.warm_start(x=program.start, y=program.duals[: len(program.lower)])
        return np.asarray(solver.solve(raise_error=False).x)

    return solve


def full_hessian(program: Program) -> Array:
    upper = program.hessian.toarray()
    return np.asarray(upper + np.triu(upper, 1).T)


def daqp_solver(first: Program, options: ReachMpcOptions) -> Callable[[Program], Array]:
    import daqp

    matrix = first.matrix.toarray()
    kinds = np.where(first.lower == first.upper, 5, 0).astype(np.int32)  # 5: an equality

    def solve(program: Program) -> Array:
        hessian = full_hessian(program)
        return np.asarray(daqp.solve(hessian, program.gradient, matrix, program.upper, program.lower, kinds)[0])

    return solve


def proxqp_solver(first: Program, options: ReachMpcOptions) -> Callable[[Program], Array]:
    from proxsuite import proxqp
    from scipy import sparse

    equal = first.lower == first.upper
    matrix = sparse.csc_matrix(first.matrix)
    dynamics, rest = sparse.csc_matrix(matrix[equal]), sparse.csc_matrix(matrix[~equal])
    solver = proxqp.sparse.QP(first.matrix.shape[1], int(equal.sum()), int((~equal).sum()))
    solver.settings.eps_abs = options.tolerance
    solver.settings.initial_guess = proxqp.InitialGuess.WARM_START
    initialised = []

    def solve(program: Program) -> Array:
        hessian = sparse.csc_matrix(program.hessian + sparse.triu(program.hessian, 1).T)
        write = solver.update if initialised else solver.init
        initialised.append(True)
        write(
            H=hessian,
            g=program.gradient,
            A=dynamics,
            b=program.lower[equal],
            C=rest,
            l=program.lower[~equal],
            u=program.upper[~equal],
        )
        solver.solve(program.start, program.duals[: len(equal)][equal], program.duals[: len(equal)][~equal])
        return np.asarray(solver.results.x)

    return solve


def times_and_solutions(solve: Callable[[Program], Array], programs: list[Program]) -> tuple[list[float], list[Array]]:
    times, solutions = [], []
    for program in programs:
        began = time.perf_counter()
        solutions.append(solve(program).copy())
        times.append(time.perf_counter() - began)
    return times, solutions


def milliseconds(runs: list[list[float]]) -> tuple[str, str]:
    """Return median and 99 % of the least of several runs of the same decisions."""
    fastest = 1e3 * np.min(runs, axis=0)
    return f"{np.median(fastest):.2f}", f"{np.quantile(fastest, 0.99):.2f}"


def main(states: int = 200, repeats: int = 5) -> None:
    """Measure, and print tables."""
    model = ArmModel("ur5")
    open_space, everything = ReachMpcOptions(pairs=0), ReachMpcOptions()
    table = markdown_table(
        "a control step", "ms", "99 %", "over the best: median", "99 %", "most", "failures",
        title=f"{states} decisions, horizon {everything.problem.horizon}",
    )  # fmt: skip
    for name, arm, options in (
        ("open space", model, open_space),
        ("with floor and self-collision constraints", model, everything),
        ("with three boxes too", model.among(BOXES), everything),
    ):
        runs = [drive(arm, options, states) for _ in progress(range(repeats), name)]
        excess = ["", "", ""]
        if options is open_space:
            reference, run = ReachReference(arm, options.problem), runs[0]
            best = [
                reference.plan(*situation, start=plan)
                for situation, plan in zip(run.situations, run.plans, strict=True)
            ]
            assert all(plan.solved for plan in best)
            over = np.array([plan.cost / other.cost - 1 for plan, other in zip(run.plans, best, strict=True)])
            excess = [f"{np.median(over):.4%}", f"{np.quantile(over, 0.99):.2%}", f"{over.max():.2%}"]
        failures = sum(not plan.solved for plan in runs[0].plans)
        table.add_row(name, *milliseconds([run.seconds for run in runs]), *excess, str(failures))
    show(table, width=160)

    programs = drive(model, open_space, states, record=True).programs
    title = f"Their {len(programs)} quadratic programs"
    table = markdown_table("a quadratic program", "ms", "99 %", "off by, rad/s", "99 %", title=title)
    exact: list[Array] = []
    for name, make in (("daqp", daqp_solver), ("OSQP", osqp_solver), ("ProxQP, sparse", proxqp_solver)):
        try:
            solve = make(programs[0], open_space)
        except ImportError:
            print(f"{name} is not installed: left out")
            continue
        results = [times_and_solutions(solve, programs) for _ in progress(range(repeats), name)]
        solutions = results[0][1]
        exact = exact or solutions
        half = len(solutions[0]) // 2
        off = np.array([np.abs(x - y)[half:].max() for x, y in zip(solutions, exact, strict=True)])
        off /= open_space.problem.period
        row = milliseconds([times for times, _ in results])
        table.add_row(name, *row, f"{np.median(off):.2g}", f"{np.quantile(off, 0.99):.2g}")
    show(table, width=160)


if __name__ == "__main__":
    typer.run(main)

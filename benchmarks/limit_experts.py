"""Decisions of experts, and what of their methods is counted as work: for `limits.py`.

Each function adds the time of its operations, in compiled code, to `costs`, and yields decisions.
"""

import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import Any
from unittest import mock

import numpy as np
from arm_planning import TOLERANCE
from limit_model import Decision, Work, closed_form_work, num_bytes
from mpc import DECISIONS, drive, osqp_solver
from one_core import ANGLE, Measure, shared, timed
from planning import GOAL_X, START, layouts

import armctl
from armctl.control.reach_mpc import ReachMpc, ReachMpcOptions
from armctl.core.arrays import Array
from armctl.envs import EpisodeVectorEnv, make_worlds
from armctl.kernels import bridge as bridge_kernel
from armctl.kernels.compiling import compiled
from armctl.kinematics import ArmModel, ArmShapes, EdgeChecker, Ik, Workspace
from armctl.planning import ArmPlanner, ArmPlannerOptions, plan_path
from armctl.policies import Policy, make_policy
from armctl.tasks.reach.obstacle_layout import ReachLayout, sample_layout

KINEMATICS, ITERATION = "forward kinematics", "iteration of the MPC's solver"
EDGE_TEST, CHECK = "edge test on the bridge", "collision check among boxes"
CASES = 20
LONG_EDGE = 8
"""Checks of an edge from which on the call takes little of the time."""
ITERATIONS = 200
"""Iterations in which the set-up of a quadratic program takes little of the time."""

Costs = dict[str, Measure]


def inverse_kinematics(costs: Costs) -> Iterator[Decision]:
    """Yield full poses by closed forms, all configurations."""
    for robot in ("ur5", "xarm7"):
        model = ArmModel(robot)
        ik, poses = Ik(model), [model.pose(q) for q in configurations(model, 50)]
        branches = np.mean([len(ik.closed_form(pose)[0]) for pose in poses]) if ik.closed_form else np.nan
        measure = timed(partial(solutions, ik, poses), len(poses))
        yield Decision(f"inverse kinematics: {robot}", measure, closed_form_work(model.dof, branches, ANGLE))


def solutions(ik: Ik, poses: list[Array], i: int) -> Array:
    return ik.pose(poses[i]).solutions


def configurations(model: ArmModel, count: int) -> Array:
    return model.random_configurations(np.random.default_rng(0), count)


def control(costs: Costs) -> Iterator[Decision]:
    """Yield decisions of the arm's MPC: a solver's iterations, and the kinematics of two motions, guess and plan."""
    model, options = ArmModel("ur5"), ReachMpcOptions(pairs=0)
    q = configurations(model, 4096)
    costs[KINEMATICS] = shared(timed(lambda _: model.positions(q)), len(q))
    recorded, mpc = drive(model, options, 4 * DECISIONS, record=True), ReachMpc(model, options)
    first, program = recorded.programs[:2]
    long_solve, short_solve = (
        osqp_solver(first, replace(options, max_iterations=count, tolerance=1e-15)) for count in (ITERATIONS, 1)
    )
    costs[ITERATION] = shared(timed(lambda _: long_solve(program)), ITERATIONS)
    iterations = float(np.mean([plan.iterations for plan in recorded.plans]))
    numbers = first.hessian.nnz + first.matrix.nnz + 3 * len(first.gradient) + 3 * len(first.lower)
    work = Work(
        bytes=num_bytes(np.empty(numbers)),
        operations={ITERATION: iterations, KINEMATICS: 2 * options.problem.horizon},
    )

    def plan(i: int) -> None:
        if i % DECISIONS == 0:
            mpc.reset()
        mpc.plan(*recorded.situations[i])

    yield Decision("MPC: one after the other", timed(plan, len(recorded.situations)), work)
    yield Decision(
        "MPC: its program, one iteration", timed(lambda _: short_solve(program)), Work(operations={ITERATION: 1})
    )
    worlds = make_worlds(armctl.DEFAULT_ENV, 1)
    policy: Any = make_policy("reach_mpc", worlds, policy_seed=0)
    plans, decide = list[Any](), between_steps(policy, worlds)
    with mock.patch.object(policy.controllers[0].mpc, "plan", noted(policy.controllers[0].mpc.plan, plans)):
        decide(1.0)
    iterations = float(np.median([plan.iterations for plan in plans]))
    yield Decision(
        "MPC: `reach_mpc` between physics steps",
        decide,
        replace(work, operations=work.operations | {ITERATION: iterations}),
    )


def noted(function: Callable[..., Any], results: list[Any]) -> Callable[..., Any]:
    """Return the function, which adds what it returns to the results."""

    def call(*arguments: Any) -> Any:
        results.append(function(*arguments))
        return results[-1]

    return call


def between_steps(policy: Policy, worlds: EpisodeVectorEnv) -> Measure:
    """Measure a policy's decisions in episodes, without the control steps."""
    everywhere = np.arange(worlds.num_envs, dtype=np.int32)

    def run(seconds: float) -> float:
        times, end = list[float](), time.perf_counter() + seconds
        while time.perf_counter() < end or not times:
            observations, _ = worlds.reset()
            policy.reset(everywhere)
            finished = np.zeros(worlds.num_envs, bool)
            while not finished.any():
                begin = time.thread_time()
                actions = policy.act(observations)
                times.append(time.thread_time() - begin)
                observations, _, terminated, truncated, _ = worlds.step(actions)
                finished = terminated | truncated
        return float(np.median(times))

    worlds.reset(seed=0)
    return run


def bridge_plan(costs: Costs) -> Iterator[Decision]:
    """Yield plans over bridges: the tests of edges that they make."""
    maps = layouts(CASES)
    tests = [recorded_tests(partial(plan_path, bridge, START, GOAL_X)) for bridge in maps]
    total = sum(len(edges) for _, edges in tests)
    costs[EDGE_TEST] = shared(timed(lambda i: test_edges(*tests[i]), CASES), total / CASES)
    work = Work(bytes=float(np.mean([num_bytes(deck[0]) for deck, _ in tests])), operations={EDGE_TEST: total / CASES})
    yield Decision("plan: bridge", timed(lambda i: plan_path(maps[i], START, GOAL_X), CASES), work)


@compiled
def test_edges(deck, edges):
    """Test edges (n, 4), from x, y to x, y; return how many are free."""
    free = 0
    for i in range(len(edges)):
        free += bridge_kernel.edge_is_free(*deck, edges[i, 0], edges[i, 1], edges[i, 2], edges[i, 3])
    return free


def recorded_tests(plan: Callable[[], object]) -> tuple[tuple[Any, ...], Array]:
    """Return the deck and the edges (n, 4) that a plan tests, with its searches in Python."""
    tests, test = list[tuple[Any, ...]](), bridge_kernel.edge_is_free

    def edge_is_free(*arguments: Any) -> bool:
        tests.append(arguments)
        return bool(test(*arguments))

    searches = {name: getattr(bridge_kernel, name).py_func for name in ("march", "shorten", "pull")}
    with mock.patch.multiple(bridge_kernel, edge_is_free=edge_is_free, **searches):
        plan()
    return tests[0][:4], np.array([arguments[4:] for arguments in tests])


def arm_plan(costs: Costs) -> Iterator[Decision]:
    """Yield plans among boxes: the configurations that they check for collisions."""
    model, rng = ArmModel("ur5"), np.random.default_rng(0)
    workspace, planner = Workspace(model), ArmPlanner(model)
    cases = [sample_layout(rng, workspace, TOLERANCE) for _ in range(CASES)]
    edges = [edge for case in cases for edge in long_edges(model, case)]
    checks = sum(checker.checks for checker, _ in edges)
    costs[CHECK] = shared(timed(lambda i: edges[i][0].is_edge_free(*edges[i][1]), len(edges)), checks / len(edges))

    def plan(i: int) -> Any:
        return planner.plan(model.home, cases[i].target, TOLERANCE, cases[i].boxes)

    count = float(np.mean([plan(i).checks for i in range(CASES)]))
    moved = float(np.mean([num_bytes(*vars(case.boxes).values()) for case in cases]))
    yield Decision("plan: arm among boxes", timed(plan, CASES), Work(bytes=moved, operations={CHECK: count}))


def long_edges(model: ArmModel, case: ReachLayout) -> Iterator[tuple[EdgeChecker, tuple[Array, Array]]]:
    """Yield checkers of edges that take many checks, each with as many as its edge takes, and the ends."""
    shapes = ArmShapes(model)
    for ends in itertools.pairwise(configurations(model, 100)):
        checker = EdgeChecker(shapes, case.boxes, ArmPlannerOptions().clearance, model.home)
        checker.checks = 0
        checker.is_edge_free(*ends)
        if checker.checks >= LONG_EDGE:
            yield checker, ends

import runpy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import osqp
import pytest

from armctl.control.reach_mpc import ReachMpc, ReachMpcOptions
from armctl.control.reach_problem import OcpParameters, ReachProblem, braking
from armctl.control.streaming import CommandStream
from armctl.core.errors import ConfigurationError
from armctl.kinematics import ArmModel, Ik
from armctl.scene import Boxes

from ..arms import named_arm
from ..kernels.joint_profiles import TICK, limited, towards

REFERENCE = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "reach_reference.py"))
ReachReference, reach_cost = REFERENCE["ReachReference"], REFERENCE["reach_cost"]
PERIOD, N = ReachProblem().period, ReachProblem().horizon
MODEL = ArmModel("ur5")
LIMITS = MODEL.limits


def reach(model, rng):
    """A target, and a free posture there that is soon reached from home."""
    ik = Ik(model)
    while True:
        q = rng.uniform(-np.pi, np.pi, model.dof)
        if model.is_free(q):
            target = model.position(q)
            goals = np.array(list(ik.free_configurations(target))).reshape(-1, model.dof)
            if len(goals):
                goals = model.nearest_turn(goals, model.home)
                return target, goals[np.argmin(model.min_time(model.home, goals))]


def states(rng, count):
    """Joint states from which a stop within the limits is possible, many of them at limits."""
    for _ in range(count):
        velocity = np.clip(rng.uniform(-1.5, 1.5, 6), -1, 1) * LIMITS.velocity
        room = np.abs(velocity) * (np.abs(velocity) / (2 * LIMITS.acceleration) + PERIOD / 2)
        low = LIMITS.lower + np.where(velocity < 0, room, 0.0)
        high = LIMITS.upper - np.where(velocity > 0, room, 0.0)
        yield low + np.clip(rng.uniform(-0.3, 1.3, 6), 0, 1) * (high - low), velocity


def check(motion, lower=LIMITS.lower, upper=LIMITS.upper):
    """Dynamics and limits."""
    q, v, a = motion.positions, motion.velocities, motion.accelerations
    assert (q.shape, v.shape, a.shape) == ((N + 1, 6), (N + 1, 6), (N, 6))
    np.testing.assert_allclose(v[1:], v[:-1] + PERIOD * a, atol=1e-12)
    np.testing.assert_allclose(q[1:], q[:-1] + PERIOD * v[:-1] + PERIOD**2 / 2 * a, atol=1e-12)
    assert (np.abs(v) <= LIMITS.velocity + 1e-9).all()
    assert (np.abs(a) <= LIMITS.acceleration + 1e-9).all()
    assert (q >= lower - 1e-9).all()
    assert (q <= upper + 1e-9).all()


@pytest.mark.slow
@pytest.mark.parametrize("posture", [True, False])
def test_plans_keep_dynamics_and_limits_and_can_go_on_for_ever(posture):
    rng, mpc = np.random.default_rng(0), ReachMpc(MODEL)
    for q, v in states(rng, 40):
        mpc.reset()
        target, goal = rng.uniform(-0.8, 0.8, 3), rng.uniform(LIMITS.lower, LIMITS.upper) if posture else None
        plan = mpc.plan(q, v, target, goal)
        assert plan.solved
        check(plan)
        situation = OcpParameters.checked(ReachProblem(), 6, plan.positions[-1], plan.velocities[-1], target, None)
        check(braking(ReachProblem(), LIMITS, situation), LIMITS.lower - 2e-3, LIMITS.upper + 2e-3)
        for _ in range(3):
            plan = mpc.plan(plan.positions[1], plan.velocities[1], target, goal)
            check(plan)
    assert mpc.failures == 0


def test_too_fast_to_stop_it_breaks_limits_no_more_than_braking_does():
    mpc, v = ReachMpc(MODEL), 1.2 * LIMITS.velocity
    q = LIMITS.upper - 0.05
    worst = braking(ReachProblem(), LIMITS, OcpParameters.checked(ReachProblem(), 6, q, v, np.zeros(3), None))
    plan = mpc.plan(q, v, np.array([0.4, 0.2, 0.4]))
    assert (plan.positions <= np.maximum(LIMITS.upper, worst.positions.max(axis=0)) + 1e-9).all()
    assert (np.abs(plan.accelerations) <= LIMITS.acceleration + 1e-9).all()


def test_a_plan_is_worth_its_cost():
    rng, mpc = np.random.default_rng(1), ReachMpc(MODEL, ReachMpcOptions(pairs=0))
    for q, v in states(rng, 20):
        mpc.reset()
        target, goal = reach(MODEL, rng)
        goal = goal if rng.random() < 0.5 else None
        plan = mpc.plan(q, v, target, goal)
        situation = OcpParameters.checked(ReachProblem(), 6, q, v, target, goal)
        assert plan.cost == pytest.approx(reach_cost(MODEL, ReachProblem(), situation, plan))
        nothing = braking(ReachProblem(), LIMITS, situation)
        if goal is None:  # else the way to it may cost more at first
            assert plan.cost <= reach_cost(MODEL, ReachProblem(), situation, nothing)


@pytest.mark.slow
def test_plans_in_closed_loop_cost_what_converged_ones_do():
    rng, mpc, reference = np.random.default_rng(2), ReachMpc(MODEL, ReachMpcOptions(pairs=0)), ReachReference(MODEL)
    excess = []
    for episode in range(4):
        target, goal = reach(MODEL, rng)
        mpc.reset()
        q, v = MODEL.home, np.zeros(6)
        for k in range(20):
            swing = 0.1 * np.sin(2 * PERIOD * np.arange(k + 1, k + N + 1)) * (episode % 2)
            targets = target + swing[:, None] * (1.0, -1.0, 0.5)
            plan = mpc.plan(q, v, targets, goal)
            best = reference.plan(q, v, targets, goal, start=plan)
            assert best.solved
            check(best)
            excess.append(plan.cost / best.cost - 1)
            q, v = plan.positions[1], plan.velocities[1]
    assert min(excess) > -1e-3  # or the reference were none
    first, later = excess[::20], np.delete(excess, np.s_[::20])
    assert max(first) < 0.2  # these have no last plan to begin from
    assert np.quantile(later, 0.98) < 0.05
    assert np.median(later) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["ur3", "ur5", "panda"])
def test_symbolic_kinematics_are_the_models(robot):
    casadi = pytest.importorskip("casadi")
    model = ArmModel(named_arm(robot))
    q = casadi.SX.sym("q", model.dof)
    position = casadi.Function("position", [q], [REFERENCE["symbolic_position"](model, q)])
    for sample in np.random.default_rng(0).uniform(-3, 3, (20, model.dof)):
        np.testing.assert_allclose(position(sample).full().ravel(), model.position(sample), atol=1e-12)


def test_a_moving_target_is_met():
    mpc, stream = ReachMpc(MODEL), CommandStream(LIMITS, PERIOD, MODEL.home)
    centre, error = MODEL.position(MODEL.home) + np.array((0.05, 0.1, 0.1)), []
    for k in range(80):
        angle = 2.0 * PERIOD * np.arange(k + 1, k + N + 1)  # 0.3 m/s
        targets = centre + 0.15 * np.stack((np.cos(angle), np.sin(angle), 0 * angle), axis=-1)
        stream.goal(mpc.plan(stream.position, stream.velocity, targets, MODEL.home))
        error.append(np.linalg.norm(MODEL.position(stream.position) - targets[0]))
    assert max(error[40:]) < 0.005


def test_boxes_are_kept_clear_of_and_most_targets_are_reached():
    rng, reached = np.random.default_rng(0), []
    for _ in range(6):
        model = MODEL.among(
            Boxes(rng.uniform((-0.7, -0.7, 0.1), (0.7, 0.7, 0.6), (3, 3)), rng.uniform(0.03, 0.12, (3, 3)), np.zeros(3))
        )
        if not model.is_free(model.home):
            continue
        target, goal = reach(model, rng)
        mpc, stream = ReachMpc(model), CommandStream(LIMITS, PERIOD, model.home)
        position, velocity = model.home, np.zeros(6)
        for _ in range(40):
            command = stream.goal(mpc.plan(stream.position, stream.velocity, target, goal))
            for _ in range(5):
                velocity = limited(towards(command, position, LIMITS), position, velocity, LIMITS)
                position = position + velocity * TICK
                assert model.is_free(position)
        reached.append(np.linalg.norm(model.position(position) - target) < 0.05)
    assert np.mean(reached) >= 0.6  # the others wait at a box: the optimisation is local


def test_a_plan_goes_on_from_the_straight_way_that_was_begun():
    rng = np.random.default_rng(3)
    target, goal = reach(MODEL, rng)
    mpc = ReachMpc(MODEL)
    begun = mpc.begin(MODEL.home, np.zeros(6), goal)
    np.testing.assert_array_equal(begun.positions[0], MODEL.home)
    assert (np.abs(begun.velocities) <= LIMITS.velocity + 1e-9).all()
    assert (np.abs(begun.accelerations) <= LIMITS.acceleration + 1e-9).all()
    assert ((begun.positions[-1] - MODEL.home) * (goal - MODEL.home) >= -1e-9).all()
    plan = mpc.plan(begun.positions[1], begun.velocities[1], target, goal)
    assert plan.solved
    assert plan.iterations <= ReachMpcOptions().max_iterations  # of one program
    with pytest.raises(ConfigurationError, match="posture"):
        mpc.begin(MODEL.home, np.zeros(6), np.full(6, np.nan))


def test_a_wall_on_the_way_stops_the_tip_before_it():
    """Without a way around, the price of the wall is never paid."""
    home = MODEL.position(MODEL.home)
    wall = Boxes(np.array([[home[0] + 0.25, home[1], home[2]]]), np.array([[0.02, 1.0, 1.0]]), np.zeros(1))
    model = MODEL.among(wall)
    assert model.is_free(model.home)
    mpc = ReachMpc(model)
    q, v = model.home, np.zeros(6)
    for _ in range(30):
        plan = mpc.plan(q, v, home + np.array((0.4, 0.0, 0.0)))
        q, v = plan.positions[1], plan.velocities[1]
        assert model.is_free(q)
    assert model.position(q)[0] > home[0] + 0.1
    assert plan.clearance > 0.01


@pytest.mark.parametrize(("status", "x"), [("OSQP_PRIMAL_INFEASIBLE", 1.0), ("OSQP_SOLVED", np.nan)])
def test_it_brakes_and_counts_when_the_solver_fails(monkeypatch, status, x):
    mpc, (target, goal) = ReachMpc(MODEL), reach(MODEL, np.random.default_rng(3))
    plan = mpc.plan(MODEL.home, np.zeros(6), target, goal)
    for _ in range(5):
        plan = mpc.plan(plan.positions[1], plan.velocities[1], target, goal)
    info = SimpleNamespace(status_val=getattr(osqp.SolverStatus, status), iter=7)
    for solver in (mpc._unconstrained, mpc._constrained):
        failed = SimpleNamespace(info=info, x=np.full(len(solver.qp.gradient), x), y=np.zeros(len(solver.qp.lower)))
        monkeypatch.setattr(solver, "_osqp", SimpleNamespace(
            update=lambda **_: None, warm_start=lambda **_: None, solve=lambda failed=failed, **_: failed,
        ))  # fmt: skip
    plan = mpc.plan(plan.positions[1], plan.velocities[1], target, goal)
    assert not plan.solved
    assert mpc.failures == 1
    check(plan)
    before, after = np.abs(plan.velocities[:-1]), np.abs(plan.velocities[1:])
    np.testing.assert_allclose(after, np.maximum(before - LIMITS.acceleration * PERIOD, 0), atol=1e-12)
    assert np.abs(before[0]).max() > 0.5
    monkeypatch.undo()
    assert mpc.plan(plan.positions[1], plan.velocities[1], target, goal).solved


def test_the_same_situations_give_the_same_plans():
    rng = np.random.default_rng(4)
    target, goal = reach(MODEL, rng)
    mpc, plans = ReachMpc(MODEL), []
    for _ in range(2):
        mpc.reset()
        plan = mpc.plan(MODEL.home, np.zeros(6), target, goal)
        plans.append(mpc.plan(plan.positions[1], plan.velocities[1], target, goal).positions)
    np.testing.assert_allclose(plans[0], plans[1], atol=1e-6)


def test_what_it_cannot_use_is_refused():
    good: list[Any] = [MODEL.home, np.zeros(6), np.zeros(3), MODEL.home]
    mpc = ReachMpc(MODEL)
    for i, name in enumerate(("position", "velocity", "targets", "posture")):
        for bad in (np.zeros(5), np.full(np.shape(good[i]), np.nan), "far", np.zeros((N + 1, 3))):
            with pytest.raises(ConfigurationError, match=name):
                mpc.plan(*[bad if at == i else one for at, one in enumerate(good)])
    for options in ({"horizon": 1}, {"period": 0.0}, {"posture": -1.0}, {"velocity": np.nan}, {"acceleration": np.inf}):
        with pytest.raises(ConfigurationError):
            ReachProblem(**options)
    for options in (
        {"max_iterations": 1.5},
        {"pairs": -1},
        {"slack_penalty": 0.0},
        {"margin": np.nan},
    ):
        with pytest.raises(ConfigurationError, match=next(iter(options))):
            ReachMpcOptions(**options)

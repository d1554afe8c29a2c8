"""Set-points for a real arm: limits, guards, faults, and targets that cannot be reached."""

import time

import numpy as np
import pytest

from armctl.control.reach import ReachController, ReachControllerOptions, State
from armctl.core.errors import ConfigurationError
from armctl.kinematics.clearance import Clearance
from armctl.scene import Boxes

TARGETS = np.array([[0.4, 0.2, 0.5], [-0.3, 0.5, 0.4], [0.1, -0.5, 0.3]])
UNREACHABLE = np.array([2.0, 0.0, 0.5])
ROUND_OFF = 1e-6


def controller(act=None, boxes=None, **options):
    chosen = ReachControllerOptions(**{"rate": 125.0, "background": False, **options})
    return ReachController("ur5", chosen, act=act, **({} if boxes is None else {"boxes": boxes}))


def follow(arm, target, steps, stop_when=None):
    """Play `target`, or what a function of the step returns, with an arm that is where it is told to be."""
    points = []
    q, qd = arm._motion.state[:2] if arm._is_running else (arm.model.home, np.zeros(6))
    for k in range(steps):
        point = arm.step(q, qd, target(k) if callable(target) else target, arm.period * (arm._ticks + 1))
        if point is None:
            break
        q, qd = point.position, point.velocity
        points.append(point)
        if point.state is stop_when and arm._motion.is_at_rest:
            break
    return points


def assert_limits_are_kept(arm, points):
    position, velocity, acceleration = (
        np.array([getattr(point, name) for point in points]) for name in ("position", "velocity", "acceleration")
    )
    options, limits, period = arm.options, arm.model.limits, arm.period
    allowed = (1 + ROUND_OFF) * np.array([limits.velocity, limits.acceleration, limits.jerk])
    shares = options.velocity, options.acceleration, options.jerk
    jerk = np.diff(acceleration, axis=0) / period
    for values, limit, share in zip((velocity, acceleration, jerk), allowed, shares, strict=True):
        assert (np.abs(values) <= share * limit).all()
    means = (velocity[1:] + velocity[:-1]) / 2
    largest = options.jerk * limits.jerk * period**3 / 8  # of a period's mean, by the trapezoidal rule
    assert (np.abs(np.diff(position, axis=0) - period * means) <= largest + ROUND_OFF).all()
    assert (position >= limits.lower - ROUND_OFF).all()
    assert (position <= limits.upper + ROUND_OFF).all()
    assert (Clearance(arm.model, options.margin).min_distances(position) >= options.margin - ROUND_OFF).all()
    assert arm.model.are_free(position).all()


@pytest.mark.parametrize("rate", [125.0, 500.0])
def test_it_reaches_within_all_limits_also_if_the_target_jumps_on_the_way(rate):
    arm = controller(rate=rate)
    points = follow(arm, TARGETS[0], round(0.3 * rate))
    assert points[-1].state is State.MOVING
    points += follow(arm, TARGETS[1], round(6 * rate), State.ARRIVED)
    assert points[-1].state is State.ARRIVED
    assert np.linalg.norm(arm.model.position(points[-1].position) - TARGETS[1]) < 1e-4
    assert_limits_are_kept(arm, points)
    assert max(np.abs(point.velocity / arm.model.limits.velocity).max() for point in points) > 0.45


def test_it_stays_beside_a_target_that_moves():
    arm = controller()
    follow(arm, TARGETS[0], 1000, State.ARRIVED)
    points = follow(arm, lambda k: TARGETS[0] + (0.0, 0.1 * k * arm.period, 0.0), 125)
    assert np.linalg.norm(arm.model.position(points[-1].position) - TARGETS[0] - (0.0, 0.1, 0.0)) < 0.01
    assert_limits_are_kept(arm, points)


def test_no_goals_lead_out_of_the_limits_or_into_anything():
    """Those of a raging agent, which are anywhere, also in the floor, in a box and in the arm itself."""
    rng, workspace = np.random.default_rng(0), ((-0.7, -0.7, 0.1), (0.7, 0.7, 0.9))
    box = Boxes(np.array([[0.5, 0.5, 0.3]]), np.array([[0.1, 0.2, 0.3]]), np.array([0.3]))
    options = {"velocity": 1.0, "acceleration": 1.0, "jerk": 1.0, "workspace": workspace}
    arm = controller(lambda _: rng.uniform(-3.0, 3.0, 6), box, **options)
    points = follow(arm, TARGETS[0], 1500)
    points += follow(arm, None, 200, State.WAITING)
    assert points[-1].state is State.WAITING
    assert_limits_are_kept(arm, points)
    tips = arm.model.positions(np.array([point.position for point in points]))
    assert ((tips >= workspace[0]) & (tips <= workspace[1])).all()
    assert any("no longer safe" in point.reason for point in points)
    assert len({point.state for point in points}) >= 4


@pytest.mark.parametrize(
    ("target", "state", "reason"),
    [
        (UNREACHABLE, State.BLOCKED, "out of reach"),
        ((0.0, 0.0, -0.5), State.BLOCKED, "outside the workspace"),
        ((np.nan, 0.0, 0.5), State.BLOCKED, "no finite position"),
        (None, State.WAITING, ""),
        ("planner", State.BLOCKED, "planning failed: RuntimeError: broken"),
    ],
)
def test_without_a_motion_to_the_target_it_stops_and_goes_on_with_the_next(target, state, reason, monkeypatch):
    arm = controller(workspace=((-2.5, -2.5, 0.0), (2.5, 2.5, 2.0)))
    points = follow(arm, TARGETS[0], 40)
    with monkeypatch.context() as broken:
        if isinstance(target, str):
            target = TARGETS[1]
            broken.setattr(arm._search, "at_centre", lambda *_: (_ for _ in ()).throw(RuntimeError("broken")))
        points += follow(arm, target, 200, state)
    assert points[41].state is State.STOPPING
    assert points[-1].state is state
    assert reason in points[-1].reason
    points += follow(arm, TARGETS[1], 1000, State.ARRIVED)
    assert points[-1].state is State.ARRIVED
    assert_limits_are_kept(arm, points)


NAN = np.full(6, np.nan)


def STALE(q, qd):  # noqa: N802
    """Measurements whose stamp stays the same."""
    return q, qd


def read(point, measured):
    return measured(point.position, point.velocity)


@pytest.mark.parametrize(
    ("measured", "fault"),
    [
        (lambda q, qd: (None, None), "no measurement for 56 ms"),
        (lambda q, qd: (NAN, qd), "no finite measurement for 56 ms"),
        (lambda q, qd: (q, NAN), "no finite measurement for 56 ms"),
        (STALE, "no new measurement for 56 ms"),
    ],
)
def test_without_measurements_it_brakes_within_the_limits_and_waits_to_be_acknowledged(measured, fault):
    arm = controller()
    points = follow(arm, TARGETS[0], 40)
    points += [arm.step(*read(points[-1], measured), TARGETS[0], 1.0)]
    points += [arm.step(points[-1].position, points[-1].velocity, TARGETS[0], 2.0)]
    assert points[-2].state is points[-1].state is State.MOVING, "one reading may be lost"
    while points[-1] is not None:
        points.append(arm.step(*read(points[-1], measured), TARGETS[0], 2.0 if measured is STALE else len(points)))
    *points, _ = points
    assert fault in arm.fault
    assert points[-2].state is State.STOPPING
    assert np.abs(points[-1].velocity).max() < ROUND_OFF
    assert_limits_are_kept(arm, points)
    assert arm.step(points[-1].position, np.zeros(6), TARGETS[0], 9.0) is None
    arm.acknowledge()
    assert follow(arm, TARGETS[0], 1000, State.ARRIVED)[-1].state is State.ARRIVED


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda q, qd: (q + 0.2, qd), "rad away from its set-points"),
        (lambda q, qd: (q, qd + 4.0), "times its speed limit"),
    ],
)
def test_an_arm_that_does_not_follow_gets_no_more_set_points(change, fault):
    arm = controller()
    last = follow(arm, TARGETS[0], 40)[-1]
    assert arm.step(*change(last.position, last.velocity), TARGETS[0], 100.0) is None
    assert fault in arm.fault
    assert arm.step(last.position, last.velocity, TARGETS[0], 101.0) is not None, "it is back: it brakes"


def test_it_begins_at_rest_within_the_limits_only():
    arm = controller()
    assert arm.step(None, None, TARGETS[0]) is None
    assert arm.step(arm.model.home, np.full(6, 0.2), TARGETS[0]) is None
    with pytest.raises(ConfigurationError, match="begin at rest"):
        arm.begin(arm.model.home, np.full(6, 0.2))
    with pytest.raises(ConfigurationError, match="within their limits"):
        arm.step(arm.model.limits.upper + 0.1, np.zeros(6), TARGETS[0])
    assert arm.step(arm.model.home, np.zeros(6), TARGETS[0]).state is State.MOVING


def test_set_points_do_not_wait_for_a_plan():
    arm = controller(background=True)
    choose = arm._choose
    arm._choose = lambda *request: (time.sleep(0.05), choose(*request))[1]
    began = time.monotonic()
    first = follow(arm, TARGETS[0], 1)[0]
    assert time.monotonic() - began < 0.05
    assert first.state is State.WAITING
    while (point := follow(arm, TARGETS[0], 1)[0]).state is State.WAITING:
        time.sleep(0.005)
    assert point.state is State.MOVING
    arm.close()


@pytest.mark.parametrize("rate", [25.0, 125.0, 500.0])
def test_an_agent_decides_25_times_a_second(rate):
    decisions = []
    arm = controller(lambda observation: decisions.append(observation) or observation[3:9], rate=rate)
    follow(arm, TARGETS[0], round(rate))
    assert 25 <= len(decisions) <= 26
    position, joints, target = np.split(decisions[0], (3, 9))
    np.testing.assert_allclose(position, arm.model.position(joints), atol=1e-9)
    assert target.tolist() == TARGETS[0].tolist()


def test_an_agent_that_fails_stops_the_arm():
    decisions = iter([np.array([0.5, -1.5, 1.5, -1.5, -1.5, 0.0])] * 5)
    arm = controller(lambda observation: next(decisions))
    points = follow(arm, TARGETS[0], 200, State.BLOCKED)
    assert "the agent failed: StopIteration" in points[-1].reason
    assert_limits_are_kept(arm, points)

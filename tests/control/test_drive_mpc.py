import copy
import dataclasses
import gc
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import casadi
import numpy as np
import pytest

from armctl.control.drive_mpc import DriveMpc, DriveMpcOptions
from armctl.control.drive_nlp import CONTROLS, DriveSolver, drive_nlp
from armctl.core.errors import ConfigurationError
from armctl.planning import plan_path
from armctl.tasks.bridge.layout import sample_layout

OPTIONS = DriveMpcOptions(max_rim_speed=2.45)
STRAIGHT = [(0.0, 0.0), (20.0, 0.0)]
CLOCK = OPTIONS.period * np.arange(OPTIONS.steps + 1)


def open_deck(points):
    """No obstacle stands there."""
    return np.zeros((len(points), 0, 2))


def walking(start, velocity, time=0.0):
    """One walker's places over the horizon, (steps + 1, 1, 2)."""
    return (np.array(start) + np.outer(time + CLOCK, velocity))[:, None]


def next_pose(pose, velocity, command):
    """By the equations of a unicycle with constant accelerations, in small steps."""
    pose, substeps = np.array(pose, dtype=float), 200
    for share in (np.arange(substeps) + 0.5) / substeps:
        linear, angular = np.array(velocity) + share * (np.array(command) - velocity)
        pose += OPTIONS.period / substeps * np.array((linear * np.cos(pose[2]), linear * np.sin(pose[2]), angular))
    return pose


def drive(mpc, decisions, pose=(0.0, 0.0, 0.0), walker=None):
    """Poses and results of a robot that does as it is told."""
    velocity, poses, results = np.zeros(2), [np.array(pose, dtype=float)], []
    for k in range(decisions):
        people = None if walker is None else walking(walker[0], walker[1], k * OPTIONS.period)
        results.append(mpc.decide(poses[-1], velocity, people))
        poses.append(next_pose(poses[-1], velocity, results[-1].command))
        velocity = np.array(results[-1].command)
    return np.array(poses), results


def hard_scenes(count, seed=0):
    """Controllers in the middle of bridges, with a pose, a velocity and a walker each."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        bridge = sample_layout(rng, 20.0, 4.0, 5, 0, 1).map
        path = plan_path(bridge, (1.0, 0.0), 19.0).path
        mpc = DriveMpc(path, bridge.nearest, OPTIONS)
        pose = (1.0, rng.uniform(-0.3, 0.3), rng.uniform(-0.5, 0.5))
        start, velocity = (
            (rng.uniform(2.5, 4), rng.uniform(-1.2, 1.2)),
            (rng.uniform(-0.5, 0.5), rng.uniform(-1.2, 1.2)),
        )
        yield mpc, bridge, pose, (rng.uniform(0, 2), rng.uniform(-1, 1)), walking(start, velocity)


@pytest.mark.slow
def test_plans_keep_all_limits_and_the_equations_of_motion():
    for mpc, _, pose, velocity, people in hard_scenes(25):
        result = mpc.decide(pose, velocity, people)
        assert result.solved
        velocities = np.vstack((velocity, result.velocities))
        assert (velocities[1:, 0] <= OPTIONS.max_speed).all()
        assert (velocities[1:, 0] >= -OPTIONS.max_reverse).all()
        assert (np.abs(velocities[1:, 1]) <= OPTIONS.max_turn_rate).all()
        rims = velocities[1:-1, :1] + velocities[1:-1, 1:] * (-OPTIONS.half_track, OPTIONS.half_track)
        assert np.abs(rims).max() <= OPTIONS.max_rim_speed + 1e-4
        changes = np.abs(np.diff(velocities, axis=0)) / OPTIONS.period
        assert (changes <= np.array((OPTIONS.max_acceleration, OPTIONS.max_turn_acceleration)) + 1e-9).all()
        np.testing.assert_array_equal(result.poses[0], pose)
        for k in range(OPTIONS.steps):
            expected = next_pose(result.poses[k], velocities[k], velocities[k + 1])
            np.testing.assert_allclose(result.poses[k + 1], expected, atol=1.5e-3)


def test_plans_keep_away_from_blocks_and_people_unless_they_say_otherwise():
    for mpc, bridge, pose, velocity, people in hard_scenes(25, seed=1):
        result = mpc.decide(pose, velocity, people)
        inner = result.poses[1:-1]
        assert bridge.clearance(inner[:, :2]).min() >= OPTIONS.clearance - result.intrusion - 1e-4
        apart = np.linalg.norm(inner[:, None, :2] - people[1:-1], axis=-1)
        # The disc is kept to first order of the distance, which is on the safe side within and exact at its rim.
        assert apart.min() >= OPTIONS.distance - result.intrusion * 1.5 - 1e-4


def test_the_solution_is_that_of_another_solver(monkeypatch):
    asked, solve = [], DriveSolver.solve

    def record(solver):
        asked.append((solver.knots.copy(), solver.parameters.copy(), solve(solver)))
        return asked[-1][-1]

    monkeypatch.setattr(DriveSolver, "solve", record)
    for mpc, _, pose, velocity, people in hard_scenes(8, seed=2):
        result = mpc.decide(pose, velocity, people)
        mpc.decide(result.poses[1], result.velocities[0], np.concatenate((people[1:], 2 * people[-1:] - people[-2:-1])))
    nlp = drive_nlp(OPTIONS)
    quiet: dict[str, Any] = {"ipopt.print_level": 0, "ipopt.tol": 1e-9, "print_time": False, "ipopt.sb": "yes"}
    reference = casadi.nlpsol("reference", "ipopt", nlp.problem, quiet)
    assert len(asked) >= 16
    for _, parameters, ours in asked:
        flat = ours.knots.ravel()[:-CONTROLS]
        theirs = reference(x0=flat, p=parameters, **nlp.bounds)
        assert ours.solved
        assert reference.stats()["success"]
        assert ours.cost == pytest.approx(float(theirs["f"]), abs=2e-3)
        np.testing.assert_allclose(flat, np.asarray(theirs["x"]).ravel(), atol=0.05)


def test_it_comes_back_to_its_path_and_turns_round():
    for pose in ((0.0, 0.6, 0.0), (0.0, -0.4, 1.2), (0.0, 0.0, 3.0)):
        poses, _ = drive(DriveMpc(STRAIGHT, open_deck, OPTIONS), 45, pose)
        assert abs(poses[-1, 1]) < 0.05
        assert abs(np.sin(poses[-1, 2])) < 0.05
        assert poses[-1, 0] > 5


@pytest.mark.parametrize("speed", [0.3, 0.7, 1.2])
def test_whoever_walks_across_is_waited_for_or_gone_around(speed):
    walker = ((4.0, -1.2 - speed * 0.4), (0.0, speed))
    poses, _ = drive(DriveMpc(STRAIGHT, open_deck, OPTIONS), 50, walker=walker)
    people = np.array(walker[0]) + OPTIONS.period * np.outer(np.arange(len(poses)), walker[1])
    assert np.linalg.norm(poses[:, :2] - people, axis=1).min() > OPTIONS.distance - 0.03
    assert poses[-1, 0] > 6


def test_between_walls_it_waits_for_whoever_stands_in_the_way_without_touching():
    def walls(points):
        return np.stack([np.column_stack((points[:, 0], np.full(len(points), y))) for y in (-0.6, 0.6)], axis=1)

    poses, results = drive(DriveMpc(STRAIGHT, walls, OPTIONS), 40, walker=((4.0, 0.0), (0.0, 0.0)))
    assert 4 - OPTIONS.distance - 0.3 < poses[-1, 0] < 4 - OPTIONS.distance + 0.02
    assert np.abs(results[-1].command).max() < 0.05


def test_blocks_are_driven_around_in_closed_loop():
    rng = np.random.default_rng(3)
    for _ in range(2):
        bridge = sample_layout(rng, 12.0, 4.0, 4, 0, 1).map
        path = plan_path(bridge, (1.0, 0.0), 11.0).path
        poses, _ = drive(DriveMpc(path, bridge.nearest, OPTIONS), 65, (1.0, 0.0, 0.0))
        poses = poses[poses[:, 0] < 11]
        assert bridge.clearance(poses[:, :2]).min() > OPTIONS.clearance - 0.02
        assert len(poses) < 65


def test_without_a_solution_it_brakes_and_says_so(monkeypatch):
    options = DriveMpcOptions(max_iterations=1)
    mpc = DriveMpc([(0, 0), (3, 0), (3, 3)], open_deck, options)
    result = mpc.decide((0, 0.3, 0.2), (1.0, -0.5))
    assert not result.solved
    assert mpc.failures == 1
    assert result.cost == np.inf
    assert result.command == pytest.approx((1.0 - options.max_acceleration * options.period, 0.0))
    assert (result.velocities[4:] == 0).all()
    np.testing.assert_allclose(result.poses[1], next_pose((0, 0.3, 0.2), (1.0, -0.5), result.command), atol=0.05)
    assert mpc.decide((0, 0.3, 0.2), (0.0, 0.0)).command == (0.0, 0.0)
    assert mpc.failures == 2


def test_after_a_failure_it_goes_on(monkeypatch):
    mpc, solve = DriveMpc(STRAIGHT, open_deck, OPTIONS), DriveSolver.solve
    with monkeypatch.context() as patch:
        patch.setattr(DriveSolver, "solve", lambda *told: dataclasses.replace(solve(*told), solved=False))
        assert not mpc.decide((0, 0, 0), (1, 0)).solved
    assert mpc.decide((0, 0, 0), (1, 0)).solved
    assert mpc.failures == 1


def test_what_the_solver_throws_is_a_failure(monkeypatch):
    def throw():
        raise RuntimeError("An exception was raised in the solver.")

    mpc = DriveMpc(STRAIGHT, open_deck, OPTIONS)
    monkeypatch.setattr(mpc._solvers[False, False], "_solve", throw)
    assert not mpc.decide((0, 0, 0), (1, 0)).solved
    assert mpc.failures == 1


def test_all_robots_share_one_problem():
    assert drive_nlp(DriveMpcOptions(max_speed=1.7)) is drive_nlp(DriveMpcOptions(max_speed=1.7))


def blocked(others=None):
    """Plans past someone who stands in the way, with steps of other controllers in between."""
    mpc, pose, velocity, plans = DriveMpc(STRAIGHT, open_deck, OPTIONS), np.zeros(3), np.zeros(2), []
    for k in range(12):
        plans.append(mpc.decide(pose, velocity, walking((4.0, -0.1), (-0.3, 0.05), k * OPTIONS.period)))
        pose, velocity = next_pose(pose, velocity, plans[-1].command), np.array(plans[-1].command)
        if others:
            other, _, *situation = next(others)
            other.decide(*situation)
    return plans


def test_what_others_decide_has_no_influence():
    alone = blocked()
    with ThreadPoolExecutor(2) as threads:
        plans = [threads.submit(blocked, hard_scenes(12, seed)) for seed in (4, 5)]
        for one in plans:
            for a, b in zip(alone, one.result(), strict=True):
                np.testing.assert_array_equal(a.poses, b.poses)
                assert (a.cost, a.iterations) == (b.cost, b.iterations)


@pytest.mark.slow
def test_the_search_for_another_plan_goes_on_from_step_to_step(monkeypatch):
    """With few iterations in each, it gets past somebody as it does with many at once."""
    searches, solve = [], DriveMpc._solve

    def record(mpc, start, people, knots, near=False, brief=False):
        plan = solve(mpc, start, people, knots, near, brief)
        if brief:
            searches.append((near, plan.solved))
        return plan

    monkeypatch.setattr(DriveMpc, "_solve", record)
    few, many = (
        drive(DriveMpc(STRAIGHT, open_deck, options), 30, walker=((4.0, 0.0), (0.0, 0.0)))[0][-1]
        for options in (dataclasses.replace(OPTIONS, max_search_iterations=count) for count in (10, 100))
    )
    assert (False, False) in searches
    assert (True, True) in searches
    np.testing.assert_allclose(few, many, atol=0.05)
    assert few[0] > 5


def test_controllers_can_be_copied_and_outlive_the_cache_of_problems():
    mpc = DriveMpc(STRAIGHT, open_deck, OPTIONS)
    mpc.decide((0, 0.2, 0), (1, 0))
    twin = copy.deepcopy(mpc)
    first = mpc.decide((0.1, 0.2, 0), (1, 0))
    drive_nlp.cache_clear()
    gc.collect()
    second = twin.decide((0.1, 0.2, 0), (1, 0))
    np.testing.assert_array_equal(first.poses, second.poses)
    assert mpc.decide((0.2, 0.2, 0), (1, 0)).solved


def test_left_and_right_are_alike():
    left, right = (
        DriveMpc([(0.0, side), (20.0, side)], open_deck, OPTIONS).decide((0, 0, 0.3 * side), (1, 0.2 * side))
        for side in (0.5, -0.5)
    )
    np.testing.assert_allclose(left.velocities, right.velocities * (1, -1), atol=1e-3)


@pytest.mark.parametrize(
    "arguments",
    [
        ((0, 0), (0, 0)),
        ((0, 0, np.nan), (0, 0)),
        ((0, 0, 0), (np.inf, 0)),
        ((0, 0, 0), 1.0),
        ("pose", (0, 0)),
        ((0, 0, 0), (0, 0), np.zeros((3, 1, 2))),
        ((0, 0, 0), (0, 0), np.full((26, 1, 2), np.nan)),
        ((0, 0, 0), (0, 0), "nobody"),
        (None, None),
        ((1e20, 0, 0), (0, 0)),
    ],
)
def test_unusable_input_is_refused(arguments):
    with pytest.raises(ConfigurationError, match="numbers within"):
        DriveMpc(STRAIGHT, open_deck, OPTIONS).decide(*arguments)


@pytest.mark.parametrize(
    "options", [{"steps": 1}, {"steps": 2.5}, {"period": 0.0}, {"max_speed": -1.0}, {"clearance": np.nan}]
)
def test_unusable_options_are_refused(options):
    with pytest.raises(ConfigurationError, match=next(iter(options))):
        DriveMpcOptions(**options)


@pytest.mark.parametrize("path", [[], [(0, 0)], [(0, 0), (0, 0)], [(0, 0), (np.nan, 1)]])
def test_unusable_paths_are_refused(path):
    with pytest.raises(ConfigurationError, match="path"):
        DriveMpc(path, open_deck)


@pytest.mark.slow
def test_an_interrupt_while_it_solves_is_heard():
    code = """
import numpy as np
from armctl.control.drive_mpc import DriveMpc
mpc = DriveMpc(np.array([[0.0, 0.0], [10.0, 0.0]]), lambda points: np.zeros((len(points), 0, 2)))
for k in range(2000):
    mpc.decide((0.0, 0.0, 0.0), (0.0, 0.0))
    if not k:
        print("ready", flush=True)
"""
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as deaf:
        assert deaf.stdout.readline() == "ready\n"
        deaf.send_signal(signal.SIGINT)
        _, told = deaf.communicate(timeout=300)
    assert deaf.returncode == -signal.SIGINT
    assert "KeyboardInterrupt" in told


@pytest.mark.slow
def test_nobody_else_pays_for_casadi():
    code = "import sys, armctl.control, armctl.baselines.bridge_ompl; print('casadi' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout.strip() == "False"

"""What is chosen of a closed form's configurations, beside the same in NumPy."""

import numpy as np
import pytest

from armctl.kernels import ik as kernel
from armctl.kernels.arm_lanes import LANES
from armctl.kinematics import ArmModel, Ik

from .reference import turns_near, twist_length

EXACT, NEAR, DISTINCT = 1e-8, 0.1, 1e-3


@pytest.fixture(scope="module")
def model():
    return ArmModel("ur5")


@pytest.fixture(scope="module")
def closed_form(model):
    return Ik(model).closed_form


@pytest.fixture(params=[2 * np.pi, 1.2], ids=["wide", "narrow"])
def joints(request, model):
    """An arm, and one whose limits leave out most solutions; in some poses, all."""
    joints = model.joints.copy()
    joints["lower"], joints["upper"] = -request.param, request.param
    return joints


def poses_and_seeds(model, count, seed=0):
    rng = np.random.default_rng(seed)
    return [
        (model.pose(q), near) for q, near in model.random_configurations(rng, 2 * count).reshape(count, 2, model.dof)
    ]


def check_choice(model, joints, pose, candidates, approximate, seed):
    """Compare the kernel's choice with that in NumPy; return its number."""
    solutions, residuals = np.full((len(candidates), 6), np.nan), np.full(len(candidates), np.nan)
    tolerances = EXACT, NEAR, DISTINCT
    number = kernel.choose(joints, pose, candidates, approximate, seed, tolerances, solutions, residuals)
    exact = candidates[~approximate]
    twists = [twist(model, q, pose) for q in (seed, *exact)]
    if len(exact) == 0 or twists[0] < NEAR or not all(length < EXACT for length in twists[1:]):
        assert number == kernel.NOT_ENOUGH
        return number
    inside, outside = [], []
    for q in turns_near(exact, seed, joints["lower"], joints["upper"]):
        if ((q < joints["lower"]) | (q > joints["upper"])).any():
            outside.append(q)
        elif all(np.abs(q - other).max() > DISTINCT for other in inside):
            inside.append(q)
    expected = sorted(inside or outside, key=lambda q: np.abs(q - seed).max())[: len(inside) or 1]
    assert number == len(inside)
    np.testing.assert_allclose(solutions[: len(expected)], expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(residuals[: len(expected)], [twist(model, q, pose) for q in expected], atol=1e-13)
    return number


def twist(model, q, pose):
    reached = model.pose(q)
    return twist_length(reached[:3, :3].copy(), reached[:3, 3].copy(), pose)


def test_solutions_are_those_within_the_limits_the_nearest_first(model, closed_form, joints):
    numbers = set()
    for pose, seed in poses_and_seeds(model, 100):
        candidates, approximate = closed_form(pose)
        numbers.add(check_choice(model, joints, pose, candidates, approximate, seed))
    assert len(numbers) >= 3
    assert (0 in numbers) == (joints["upper"][0] < 2)


def test_whole_turns_duplicates_and_more_candidates_than_lanes_make_no_difference(model, closed_form, joints):
    rng = np.random.default_rng(1)
    for pose, seed in poses_and_seeds(model, 30, seed=1):
        candidates, approximate = closed_form(pose)
        number = check_choice(model, joints, pose, candidates, approximate, seed)
        repeated = np.tile(candidates, (5, 1)) + 2 * np.pi * rng.integers(-2, 3, (5 * len(candidates), 6))
        assert len(repeated) > LANES
        assert check_choice(model, joints, pose, repeated, np.tile(approximate, 5), seed) == number


def test_an_inexact_candidate_is_not_enough_unless_it_counts_as_an_approximation(model, closed_form, joints):
    for pose, seed in poses_and_seeds(model, 10, seed=2):
        candidates, approximate = (np.array(part) for part in closed_form(pose))
        for row in np.flatnonzero(~approximate):
            for error in (1e-6, np.nan):
                wrong = candidates.copy()
                wrong[row, 1] += error
                assert check_choice(model, joints, pose, wrong, approximate, seed) == kernel.NOT_ENOUGH
                approximations = approximate | (np.arange(len(candidates)) == row)
                assert check_choice(model, joints, pose, wrong, approximations, seed) >= 0


def test_a_seed_near_the_pose_and_no_candidate_are_not_enough(model, closed_form, joints):
    for pose, seed in poses_and_seeds(model, 10, seed=3):
        candidates, approximate = closed_form(pose)
        solution = candidates[~approximate][0]
        assert check_choice(model, joints, pose, candidates, approximate, solution) == kernel.NOT_ENOUGH
        everything = np.ones(len(candidates), dtype=bool)
        assert check_choice(model, joints, pose, candidates, everything, seed) == kernel.NOT_ENOUGH
        assert check_choice(model, joints, pose, candidates[:0], approximate[:0], seed) == kernel.NOT_ENOUGH

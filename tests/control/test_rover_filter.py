"""The rover's safety filter: its model of sliding wheels against MuJoCo, its distances, and what it changes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armctl.control.rover_filter import RoverFilter, lifts
from armctl.envs import make_worlds
from armctl.kernels import rover_filter as kernel
from armctl.policies.robot_filters import rover_model
from armctl.scene import BridgeMap

WORLDS = make_worlds("armctl/BridgeCross-v0", 16, {"blocks": 0, "deck_width": 20.0, "missing_barriers": 0})
ROVER = rover_model(WORLDS.task.simulation.model)


def state_at(x, y, yaw, speed=0.0):
    return np.array([x, y, yaw, speed * np.cos(yaw), speed * np.sin(yaw), 0.0, *[speed] * 4])


def a_filter():
    return RoverFilter(ROVER, margin=0.06, people_margin=0.1, drift=0.02)


def test_wheels_slide_as_in_mujoco():
    """Random commands, then braking: nine in ten rovers are within 5 cm and 0.1 rad of the prediction."""
    task, rng = WORLDS.task, np.random.default_rng(0)
    WORLDS.reset(seed=0)
    for _ in range(8):
        WORLDS.step(np.tile((1.5, 0.0), (16, 1)))
    commands = [rng.uniform((0.5, -1.5), (2, 1.5), (16, 2)), *np.zeros((5, 16, 2))]
    predicted, rims = [], np.empty(2)
    for i, ((vx, vy), wheels, _) in enumerate(map(task.rover.slip, range(16))):
        state = np.concatenate((task.state.poses[i], (vx, vy, task.state.velocities[i, 1]), wheels))
        for command in commands:
            kernel.rims_of(ROVER, *command[i], rims)
            kernel.move(ROVER, state, rims, kernel.SUBSTEPS)
        predicted.append(state[:3])
    for command in commands:
        WORLDS.step(command)
    errors = np.abs(np.array(predicted) - task.state.poses)
    assert np.quantile(np.hypot(*errors[:, :2].T), 0.9) < 0.05
    assert np.quantile(errors[:, 2], 0.9) < 0.1


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_clearance_is_that_of_sampled_outlines(seed):
    rng = np.random.default_rng(seed)
    block = np.array([[3.0, 0.2, rng.uniform(-1, 1), 0.3, 0.6]])
    bridge = BridgeMap(8.0, 1.5, block)
    state = state_at(rng.uniform(1, 5), rng.uniform(-1, 1), rng.uniform(-3, 3))
    blocks, half_width, length = bridge.deck
    world = kernel.Surroundings(blocks, half_width, length, np.zeros((1, 0, 2)), np.zeros((0, 4)), 0.25, 0.0, 0.0, 0.0)
    along = np.linspace(-1, 1, 41)
    edges = np.concatenate([
        np.column_stack((x.ravel(), y.ravel()))
        for half in ROVER.outline
        for x, y in (np.meshgrid(half[0] * along, half[1] * np.array((-1, 1))),
                     np.meshgrid(half[0] * np.array((-1, 1)), half[1] * along))
    ])  # fmt: skip
    cos, sin = np.cos(state[2]), np.sin(state[2])
    points = edges @ np.array(((cos, sin), (-sin, cos))) + state[:2]
    expected = bridge.clearance(points).min()
    measured = kernel.clearance(ROVER, world, state, np.empty(10))
    if expected > 0.02:
        assert measured == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize(("yaw", "side"), [(np.pi / 2, 1.0), (-np.pi / 2, -1.0), (np.pi, 0.0)])
def test_it_stops_before_a_side_and_an_end(yaw, side):
    safe, bridge, rims = a_filter(), BridgeMap(8.0, 1.5, np.zeros((0, 5))), np.empty(2)
    state, changed = state_at(1.5, 0.0, yaw), 0
    for step in range(60):
        command = safe(bridge, state, 0.0, 0.1 * step, np.array((2.0, 0.0)))
        changed += command[0] != 2.0
        kernel.rims_of(ROVER, *command, rims)
        kernel.move(ROVER, state, rims, kernel.SUBSTEPS)
        assert abs(state[1]) < 1.5 - 0.25
        assert state[0] > 0.25
    assert changed > 0
    assert side * state[1] > 0.8 or side == 0.0


@pytest.mark.parametrize("yaw", [0.0, 0.1, -0.1, np.pi - 0.1])
def test_a_rover_too_near_to_a_side_gets_away_before_a_proposal_passes(yaw):
    safe, bridge, rims = a_filter(), BridgeMap(8.0, 1.5, np.zeros((0, 5))), np.empty(2)
    world, state = safe._surroundings(bridge, 0.0), state_at(4.0, 0.0, yaw)
    proposal, passed = np.array((0.3, 0.0)), 0
    state[1] = kernel.clearance(ROVER, world, state, np.empty(10)) - 0.03
    for step in range(20):
        command = safe(bridge, state, 0.0, 0.1 * step, proposal)
        kernel.rims_of(ROVER, *command, rims)
        kernel.move(ROVER, state, rims, kernel.SUBSTEPS)
        clearance = kernel.clearance(ROVER, world, state, np.empty(10))
        assert clearance > 0.01
        assert command is not proposal or clearance >= 0.06
        assert step > 0 or command is not proposal
        passed += command is proposal
    assert passed > 0


def test_what_is_safe_stays_as_it_is_and_wheels_do_not_rise():
    safe, bridge = a_filter(), BridgeMap(20.0, 1.5, np.zeros((0, 5)))
    proposal = np.array((1.0, 0.2))
    assert safe(bridge, state_at(5.0, 0.0, 0.0, 1.0), 0.0, 0.0, proposal) is proposal
    assert lifts(np.array((-1.0, 0.0)), 1.0, 0.3)
    assert not lifts(np.array((1.9, 0.0)), 1.0, 0.3)
    assert safe(bridge, state_at(5.0, 0.0, 0.0, 1.0), 0.3, 0.0, np.array((-2.0, 0.0)))[0] > 0.5

"""Impacts are stepped more finely, and what else happens is what it was, bit for bit."""

from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest

from armctl.robot_description import load_arm
from armctl.robots import build_arm_world
from armctl.robots.arm import speed_limits
from armctl.simulation import Simulation
from armctl.simulation.impacts import DEPTH, FAST


def arms(n, refined=True, velocity=0.0):
    description = load_arm("ur5")
    model = build_arm_world(description, "torque")
    made = Simulation(model, n, threads=1, speed_limits=speed_limits(description) if refined else None)
    made.reset()
    made.array("qvel")[:] = np.broadcast_to(velocity, (n, 6))
    made.refresh()
    return made


def test_free_motion_is_the_same_bit_for_bit():
    plain, refined = (arms(2, which, [0.5, -0.2, 0.3, 1, 1, 1]) for which in (False, True))
    for _ in range(30):
        for simulation in (plain, refined):
            simulation.step(4)
        assert not refined.refined.any()
    for field in ("qpos", "qvel", "qfrc_actuator", "xpos"):
        assert np.array_equal(plain.array(field), refined.array(field))


def worst(simulation, ticks=80):
    depth = simulation.model.sensor(DEPTH).adr[0]
    limits = load_arm("ur5").limits
    deepest = fastest = 0.0
    for _ in range(ticks):
        simulation.step(4)
        deepest = max(deepest, -simulation.array("sensordata")[:, depth].min())
        fastest = max(fastest, (np.abs(simulation.array("qvel")) / limits.velocity).max())
    return deepest, fastest


def test_an_arm_that_falls_on_the_floor_stays_above_it_and_no_joint_is_flung():
    falling = [0, 3.1, 3.1, 3.1, 0, 0]
    deepest, fastest = worst(arms(1, velocity=falling))
    assert deepest < 0.005
    assert fastest <= FAST + 1e-9
    _, without = worst(arms(1, refined=False, velocity=falling))
    assert without > FAST


def test_an_impact_in_one_world_is_nothing_to_the_others_and_the_same_alone():
    falling = np.array([0, 3.1, 3.1, 3.1, 0, 0])
    together = arms(3, velocity=np.outer([0, 1, 0.1], falling))
    alone = arms(1, velocity=falling)
    fields = "qpos", "qvel", "qfrc_actuator", "sensordata", "xpos"
    arrays = [(together.array(field), alone.array(field)) for field in fields]
    hit = False
    for _ in range(60):
        together.step(4)
        alone.step(4)
        hit |= bool(alone.refined.any())
        assert all(np.array_equal(ours[1], own[0]) for ours, own in arrays)
    assert hit
    assert not np.isclose(together.array("time"), 0).any()
    assert np.ptp(together.array("time")) < 1e-9


@pytest.mark.parametrize("env", ["armctl/ArmReachObstacles-v0", "armctl/BridgeCross-v0"])
def test_a_touch_in_finer_steps_is_not_forgotten(env):
    options = {"control": "velocity"} if "Arm" in env else {"resolution": (8, 6)}
    made: Any = gymnasium.make_vec(env, num_envs=4, threads=1, autoreset_mode="disabled", **options)
    made.reset(seed=0)
    action = made.single_action_space.high * ([1, 1, 1, 0, 0, 0] if "Arm" in env else [1, 0.1])
    simulation, refined = made.unwrapped.task.simulation, []
    depth = simulation.model.sensor(DEPTH).adr[0]
    ended = np.zeros(4, dtype=bool)
    for _ in range(60):
        _, _, terminated, *_ = made.step(np.tile(action, (4, 1)))
        refined.append(simulation.refined.any())
        ended |= terminated
        assert ended[simulation.array("sensordata")[:, depth] < 0].all()
    assert any(refined)
    assert ended.any()


def test_a_model_that_is_stepped_by_hand_keeps_its_time_step():
    simulation = arms(2, velocity=[0, 3.1, 3.1, 3.1, 0, 0])
    for _ in range(50):
        simulation.step(4)
    assert simulation.model.opt.timestep == 0.002
    assert np.allclose(simulation.array("time"), 0.4)
    mujoco.mj_step(simulation.model, simulation.data(0))

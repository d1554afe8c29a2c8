import mujoco
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.kinematics import ArmModel
from armctl.robot_description import load_arm
from armctl.robot_description.joint_profiles import FOLLOWING_ERROR
from armctl.robots import CONTROLS, Arm, build_arm_world
from armctl.robots.arm import speed_limits
from armctl.simulation import Simulation
from armctl.simulation.control_step import NO_PARTS

from ..kernels.joint_profiles import TICK, trapezoidal_displacement, travel_time

PERIOD = 0.04
TICKS = round(PERIOD / TICK)
ROBOTS = ["ur3", "ur5", "ur10"]


class Rig:
    """n simulated arms at home."""

    def __init__(self, robot, control, n=4, touches=True):
        self.description = load_arm(robot)
        self.limits = self.description.limits
        self.model = build_arm_world(self.description, control)
        if not touches:
            self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        self.simulation = Simulation(self.model, n, threads=1, speed_limits=speed_limits(self.description))
        self.arm = Arm(self.simulation, self.description, control, PERIOD)
        self.commanded = self.simulation.array("act")
        self.substeps = round(PERIOD / self.model.opt.timestep)
        self.n = n
        self.simulation.reset()
        self.simulation.refresh()

    def step(self, actions, decisions=1):
        for _ in range(decisions):
            self.arm.command(np.broadcast_to(actions, (self.n, 6)))
            self.tick(TICKS)

    def tick(self, ticks=1):
        """Go on with the last action."""
        self.simulation.control_step(ticks, self.substeps // TICKS, parts=NO_PARTS._replace(drives=self.arm.drives))

    def standstill(self):
        """The action that asks for no motion."""
        return self.arm.joint_positions.copy() if self.arm.control == "position" else np.zeros(6)

    def free_goals(self, seed=0):
        """A goal for each arm that touches nothing on its way from home."""
        rng, model = np.random.default_rng(seed), ArmModel(self.description)
        clock = np.linspace(0, 2, 100)[:, None]
        goals = []
        while len(goals) < self.n:
            way = rng.uniform(-1.5, 1.5, 6)
            if all(model.is_free(model.home + moved) for moved in trapezoidal_displacement(clock, way, self.limits)):
                goals.append(model.home + way)
        return np.array(goals)


@pytest.mark.slow
@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize("robot", ROBOTS)
def test_keyframe_is_home(robot, control):
    rig = Rig(robot, control)
    home = np.tile(rig.description.home, (rig.n, 1))
    assert rig.model.key(0).name == "home"
    np.testing.assert_array_equal(rig.arm.joint_positions, home)
    np.testing.assert_array_equal(rig.arm.joint_velocities, 0)
    if control != "torque":
        np.testing.assert_array_equal(rig.commanded, home)
    position = ArmModel(rig.description).position(rig.description.home)
    np.testing.assert_allclose(rig.arm.end_effector_positions, np.tile(position, (rig.n, 1)), atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize("robot", ROBOTS)
def test_arms_stand_still_against_gravity(robot, control):
    rig = Rig(robot, control)
    stretched = np.array([0, -0.4, 0, 0, 0, 0])  # near the worst for the shoulder, off the floor
    assert ArmModel(rig.description).is_free(stretched)
    rig.arm.joint_positions[2:] = stretched
    if control != "torque":
        rig.commanded[2:] = stretched
    start, action = rig.arm.joint_positions.copy(), rig.standstill()
    for _ in range(50):
        rig.step(action)
        assert np.abs(rig.arm.joint_positions - start).max() < 1e-3


def test_without_gravity_compensation_the_arm_would_fall():
    rig = Rig("ur5", "torque")
    rig.model.body_gravcomp[:] = 0
    rig.simulation = Simulation(rig.model, rig.n, threads=1, speed_limits=speed_limits(rig.description))
    rig.arm = Arm(rig.simulation, rig.description, "torque", PERIOD)
    rig.simulation.reset()
    rig.step(np.zeros(6), 10)
    assert np.abs(rig.arm.joint_positions - rig.description.home).max() > 0.1


@pytest.mark.one_case
@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize("robot", ROBOTS)
def test_action_bounds_are_the_limits(robot, control):
    rig = Rig(robot, control)
    limits = rig.limits
    high = {
        "position": limits.upper,
        "relative": np.full(6, 0.5),
        "delta": limits.velocity * PERIOD,
        "velocity": limits.velocity,
        "torque": limits.effort,
    }[control]
    low = limits.lower if control == "position" else -high
    np.testing.assert_allclose(rig.arm.action_low, low)
    np.testing.assert_allclose(rig.arm.action_high, high)


@pytest.mark.one_case
@pytest.mark.parametrize("robot", ROBOTS)
def test_position_command_arrives_in_the_time_that_limits_allow(robot):
    rig = Rig(robot, "position")
    goals = rig.free_goals()
    to_pass = travel_time(goals - rig.description.home, 0.0, rig.limits).max()
    to_brake = (rig.limits.velocity / rig.limits.acceleration).max()
    rig.step(goals, int(np.ceil((to_pass + to_brake) / PERIOD)))
    np.testing.assert_allclose(rig.commanded, goals, atol=1e-9)
    rig.step(goals, 15)
    np.testing.assert_allclose(rig.arm.joint_positions, goals, atol=1e-3)
    np.testing.assert_allclose(rig.arm.joint_velocities, 0, atol=1e-2)


@pytest.mark.slow
@pytest.mark.parametrize("control", ["position", "delta", "velocity"])
@pytest.mark.parametrize("robot", ROBOTS)
def test_command_keeps_to_the_limits_of_velocity_acceleration_and_position(robot, control):
    rig = Rig(robot, control, touches=False)
    rng = np.random.default_rng(0)
    command, speed = rig.commanded.copy(), np.zeros((rig.n, 6))
    fastest = hardest = 0.0
    for decision in range(60):
        wild = rng.choice([-1e6, -1, 0, 1, 1e6], (rig.n, 6)) if decision < 20 else np.full((rig.n, 6), 1e6)
        rig.arm.command(wild)
        for _ in range(TICKS):
            rig.tick()
            new_speed = (rig.commanded - command) / TICK
            fastest = max(fastest, (np.abs(new_speed) / rig.limits.velocity).max())
            hardest = max(hardest, (np.abs(new_speed - speed) / TICK / rig.limits.acceleration).max())
            command, speed = rig.commanded.copy(), new_speed
            assert (command >= rig.limits.lower - 1e-9).all()
            assert (command <= rig.limits.upper + 1e-9).all()
    assert fastest == pytest.approx(1, abs=1e-6)  # as fast as allowed, and no faster
    assert hardest == pytest.approx(1, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_a_command_waits_for_a_joint_that_is_blocked(robot):
    rig = Rig(robot, "velocity")
    rig.step(0.5 * np.array([0, 1, 0, 0, 0, 0]) * rig.limits.velocity, decisions=100)  # lean on the floor
    lag = rig.commanded - rig.arm.joint_positions
    assert 0.25 < np.abs(lag[:, 1]).max() <= FOLLOWING_ERROR + TICK * rig.limits.velocity[1]
    before = rig.arm.joint_positions.copy()
    rig.step(-0.5 * np.array([0, 1, 0, 0, 0, 0]) * rig.limits.velocity, decisions=25)
    assert (before - rig.arm.joint_positions)[:, 1].min() > 0.3  # within a second, it is on its way back


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_joints_follow_the_command_closely(robot):
    rig = Rig(robot, "position", n=32)
    rig.arm.command(rig.free_goals())
    for _ in range(150):
        rig.tick()
        assert np.abs(rig.arm.joint_positions - rig.commanded).max() < 0.05
        assert (np.abs(rig.arm.joint_velocities) < 1.2 * rig.limits.velocity).all()


@pytest.mark.parametrize("control", CONTROLS)
def test_actions_out_of_bounds_are_as_good_as_those_on_the_bounds(control):
    rng = np.random.default_rng(0)
    signs = rng.choice([-1, 1], (10, 4, 6))
    states = []
    for beyond in (1.0, 1e3):
        rig = Rig("ur5", control)
        for sign in signs:
            bound = np.where(sign > 0, rig.arm.action_high, rig.arm.action_low)
            rig.step(beyond * bound)
        states.append(rig.arm.joint_positions.copy())
    np.testing.assert_array_equal(states[0], states[1])


@pytest.mark.parametrize("robot", ROBOTS)
def test_velocity_mode_moves_at_that_velocity(robot):
    rig = Rig(robot, "velocity")
    velocities = np.array([[0.3], [-0.3], [0.1], [0.0]]) * np.ones(6)
    rig.step(velocities, 10)
    before = rig.arm.joint_positions.copy()
    rig.step(velocities, 10)
    np.testing.assert_allclose(rig.arm.joint_velocities, velocities, atol=2e-3)
    np.testing.assert_allclose((rig.arm.joint_positions - before) / (10 * PERIOD), velocities, atol=2e-3)


@pytest.mark.parametrize("robot", ROBOTS)
def test_delta_mode_displaces_by_that_much(robot):
    rig = Rig(robot, "delta")
    deltas = np.random.default_rng(0).uniform(-1, 1, (rig.n, 6)) * rig.arm.action_high
    rig.step(deltas, 10)
    before = rig.commanded.copy()
    rig.step(deltas)
    np.testing.assert_allclose(rig.commanded, before + deltas, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("control", CONTROLS)
@pytest.mark.parametrize("robot", ROBOTS)
def test_joint_torques_stay_within_the_effort_limits(robot, control):
    rig = Rig(robot, control)
    torques = rig.simulation.array("qfrc_actuator")
    largest = np.zeros(6)
    for decision in range(20):
        rig.arm.command(np.broadcast_to(1e6 * (-1) ** (decision // 4), (rig.n, 6)))
        for _ in range(TICKS):
            rig.tick()
            largest = np.maximum(largest, np.abs(torques).max(axis=0))
    assert (largest <= rig.limits.effort * (1 + 1e-9)).all()
    assert largest.max() > 0


def test_torque_mode_accelerates_as_the_equations_of_motion_say():
    rig = Rig("ur5", "torque", n=1)
    torques = np.array([3.0, -2.0, 1.0, 0.5, -0.3, 0.1])
    rig.arm.command(torques[None])
    data = rig.simulation.data(0)
    inertia = np.zeros((6, 6))
    mujoco.mj_fullM(rig.model, data, inertia)
    np.testing.assert_allclose(inertia @ data.qacc, torques, atol=1e-6)


def test_worlds_do_not_influence_each_other():
    together = Rig("ur5", "position")
    goals = together.free_goals()
    together.step(goals, 10)
    for i in range(together.n):
        alone = Rig("ur5", "position", n=1)
        alone.step(goals[i], 10)
        np.testing.assert_array_equal(alone.arm.joint_positions[0], together.arm.joint_positions[i])


@pytest.mark.parametrize(("wrong", "nearest"), [("torqe", "torque"), ("Position", "position"), ("", ""), (None, "")])
def test_unknown_control_is_told_the_names_there_are(wrong, nearest):
    with pytest.raises(ConfigurationError, match="delta, position, relative, torque, velocity") as error:
        build_arm_world(load_arm("ur5"), wrong)
    assert nearest in str(error.value)
    assert repr(wrong) in str(error.value)


def test_world_has_the_links_shapes_and_the_collision_pairs_of_the_description():
    description = load_arm("ur5")
    model = build_arm_world(description, "position")
    assert model.npair == len(description.collision_pairs)
    for capsule in description.capsules:
        geom = model.geom(f"{capsule.link}_collision")
        assert geom.size[0] == pytest.approx(capsule.radius)
        assert 2 * geom.size[1] == pytest.approx(np.linalg.norm(np.subtract(capsule.end, capsule.start)), abs=1e-6)
    assert model.nmesh == len(description.meshes)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_the_arm_stops_at_the_floor(robot):
    rig = Rig(robot, "position", n=1)
    lying = np.array([0, 0.3, 0, 0, 0, 0])
    rig.step(lying, 60)
    data = rig.simulation.data(0)
    floor = [contact for contact in data.contact if rig.model.geom("floor").id in contact.geom]
    assert floor
    assert min(contact.dist for contact in floor) > -0.01
    assert np.isfinite(rig.arm.joint_positions).all()

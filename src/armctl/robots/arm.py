"""A simulated arm: from actions to joint servos, and from the simulation's state to sensor readings."""

import functools
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np

from armctl.core.arrays import Array
from armctl.core.errors import unknown_name
from armctl.kernels.control_step import Drives
from armctl.robot_description import ArmDescription
from armctl.robot_description.capsules import Capsule
from armctl.robot_description.collision_pairs import FLOOR
from armctl.robot_description.joint_profiles import FOLLOWING_ERROR, TICK
from armctl.robot_description.meshes import thinness
from armctl.robots.joints import ActuatorLimits, JointSamples
from armctl.simulation import Simulation
from armctl.simulation.control_step import NO_PARTS
from armctl.simulation.impacts import add_impact_sensors
from armctl.simulation.planning_model import Connect, Step
from armctl.simulation.worlds import compiled_once, world_path

CONTROLS = ("position", "relative", "delta", "velocity", "torque")

LARGEST_RELATIVE_MOVE = 0.5
"""rad: a relative command moves a joint by at most this from its present position. At its speed limit, a UR5 joint
travels 0.126 rad in a control step of 0.04 s, and 0.33 rad until it stops."""

SERVO_BANDWIDTH = 60.0
"""rad/s: natural frequency of the critically damped joint servos, which settle within a tenth of a second"""

BRAKE_GAIN = 10.0
"""Gain of the brakes: with torque control, a joint a tenth above its velocity limit is braked with its full effort."""

HARD = (0.001, 1.0), (0.99, 0.99, 0.001, 0.5, 2.0)
"""`solref` and `solimp` of contacts and joint limits: as hard as physics steps of 2 ms allow (MuJoCo's manual, "Solver
parameters")."""

PREFIX = "arm/"
"""Prefix of the arm's names in a world's model."""

MIN_VOLUME = 1e-12
"""m^3, six times that of a drawn mesh: with less, MuJoCo takes it for an error."""

_VISUAL_GROUP, _COLLISION_GROUP = 2, 3


class Arm:
    """n simulated arms, commanded together; angles in rad, positions in m.

    `control` defines the meaning of an action (n, dof):

    - `position`: joint positions to move to and stop at, within the position limits;
    - `relative`: the same, relative to the present joint positions, by at most `LARGEST_RELATIVE_MOVE`;
    - `delta`: joint displacements until the next control step;
    - `velocity`: joint velocities, within the velocity limits;
    - `torque`: joint torques on top of gravity compensation, within the effort limits.

    Except for torques, `armctl.robot_description.joint_profiles` turns it into a command within the limits of position,
    velocity and acceleration, which the joint servos follow within their effort limits. They are `drives` and `joints`
    of the ticks of `Simulation.control_step`, each of `TICK` of that module.
    """

    def __init__(self, simulation: Simulation, description: ArmDescription, control: str, period: float) -> None:
        self.description = description
        self.control = control
        self.period = period
        self._positions, self._velocities = simulation.array("qpos"), simulation.array("qvel")
        self._is_alone = len(description.joints) == simulation.model.nq
        joints = [simulation.model.joint(PREFIX + name) for name in description.joints]
        self._columns = np.array([joint.qposadr[0] for joint in joints], dtype=np.intp)
        self.end_effector_positions = simulation.array("xpos")[:, simulation.model.body(PREFIX + description.tip).id]
        """(n, 3) m, a live view."""
        self._ctrl = simulation.array("ctrl")
        dof = description.dof
        self._velocity_commands = self._ctrl[:, :dof]
        self._command = simulation.array("act")
        limits = description.limits
        torques = control == "torque"
        self.drive_commands = self._command, self._velocity_commands[:, : 0 if torques else dof]
        """(n, dof) positions (rad) and velocities (rad/s) that the drives command now, live; (n, 0) for torques."""
        driven = limits.drives[:0] if torques else limits.drives
        to_positions = control in ("position", "relative")
        self.drives = Drives(driven, np.zeros((simulation.n, dof)), to_positions, FOLLOWING_ERROR, self._columns)
        actuators = ActuatorLimits(limits.velocity, limits.effort, (limits.lower, limits.upper))
        motors = self._columns if description.followers else slice(dof)
        self.joints = JointSamples(simulation, motors, actuators, round(period / TICK), period)
        move = np.full(dof, LARGEST_RELATIVE_MOVE)
        bounds = {
            "position": (limits.lower, limits.upper),
            "relative": (-move, move),
            "delta": (-limits.velocity * period, limits.velocity * period),
            "velocity": (-limits.velocity, limits.velocity),
            "torque": (-limits.effort, limits.effort),
        }
        self.action_low, self.action_high = bounds[control]

    @property
    def joint_positions(self) -> Array:
        """Positions (n, dof) of the joints that have a motor, rad; a live view if nothing else moves in the world."""
        return self._positions if self._is_alone else self._positions[:, self._columns]

    @property
    def joint_velocities(self) -> Array:
        """The same for their velocities, rad/s."""
        return self._velocities if self._is_alone else self._velocities[:, self._columns]

    @property
    def rollout_worlds(self) -> Connect:
        """Maker of worlds in which such arms are driven alike, by themselves: they do not stop at targets."""
        return functools.partial(_driven, description=self.description, control=self.control, period=self.period)

    def place(self, world: int, q: Array) -> None:
        """Put a world's arm at rest at `q` (dof,), where its drives hold it."""
        self._positions[world, self._columns] = q
        if self.control != "torque":
            self._command[world] = q

    def command(self, actions: Array) -> None:
        """Set actions (n, dof), clipped to their bounds."""
        setpoints = np.minimum(np.maximum(actions, self.action_low), self.action_high, out=self.drives.setpoints)
        if self.control == "torque":
            np.copyto(self._velocity_commands, setpoints)
        elif self.control == "delta":
            setpoints /= self.period
        elif self.control == "relative":
            limits = self.description.limits
            np.clip(self.joint_positions + setpoints, limits.lower, limits.upper, out=setpoints)


def _driven(
    model: mujoco.MjModel, n: int, *, description: ArmDescription, control: str, period: float
) -> tuple[Simulation, Step]:
    """Make n worlds of arms, and what makes their control steps."""
    simulation = Simulation(model, n, threads=1, speed_limits=speed_limits(description))
    arm, ticks = Arm(simulation, description, control, period), round(period / TICK)
    substeps, parts = round(TICK / model.opt.timestep), NO_PARTS._replace(drives=arm.drives)

    def step(actions: Array) -> None:
        arm.command(actions)
        simulation.control_step(ticks, substeps, parts=parts)

    return simulation, step


def speed_limits(description: ArmDescription) -> dict[str, float]:
    """Return the joints' speed limits, rad/s, by their names in a world's model."""
    names = (PREFIX + name for name in description.joints)
    return dict(zip(names, description.limits.velocity, strict=True))


@compiled_once
def build_arm_world(
    description: ArmDescription,
    control: str,
    furnish: Callable[[Any, ArmDescription], None] | None = None,
    add_motors: Callable[[Any], None] | None = None,
) -> mujoco.MjModel:
    """Return the MJCF world `models/arm_reach.xml` with the arm at its origin, its servos, and the keyframe `home`.

    `furnish`, a function of a module, adds to the `MjSpec` what else a task needs, and `add_motors` further motors,
    after those of the arm.

    Raises `ConfigurationError` if `control` is not one of `CONTROLS`.
    """
    if control not in CONTROLS:
        raise unknown_name("control", control, CONTROLS)
    spec = mujoco.MjSpec.from_file(str(world_path("arm_reach")))
    spec.compiler.fusestatic = False
    arm = mujoco.MjSpec.from_string(_with_compiler_options(description.urdf))
    spec.attach(arm, frame=spec.worldbody.add_frame(), prefix=PREFIX)
    for body in spec.bodies:
        body.gravcomp = 1.0
    _add_shapes(spec, description)
    for name, effort in zip(description.joints, description.limits.effort, strict=True):
        joint = spec.joint(PREFIX + name)
        joint.actgravcomp = True  # gravity compensation counts towards the joint's effort
        joint.actfrclimited = True
        joint.actfrcrange = [-effort, effort]
        joint.solref_limit, joint.solimp_limit = HARD
    for follower in description.followers:
        spec.joint(PREFIX + follower.joint).limited = mujoco.mjtLimited.mjLIMITED_FALSE  # its leader has limits
    for equality in spec.equalities:
        equality.solref, equality.solimp = HARD
    for name, armature in zip(description.joints, description.armature, strict=False):
        spec.joint(PREFIX + name).armature = armature
    add_impact_sensors(spec, speed_limits(description), round(TICK / spec.option.timestep))
    if furnish is not None:
        furnish(spec, description)
    model, joints = spec.compile(), description.all_positions(description.home)
    home = np.append(joints, model.qpos0[len(joints) :])
    if control == "torque":
        _add_motors(spec, description)
        spec.add_key(name="home", qpos=home)
    else:
        _add_servos(spec, description, _joint_inertia(model, description))
        spec.add_key(name="home", qpos=home, act=description.home)
    if add_motors is not None:
        add_motors(spec)
    return spec.compile()


def _with_compiler_options(urdf: str) -> str:
    options = '<mujoco><compiler fusestatic="false" balanceinertia="false"/></mujoco>'
    head, tail = urdf.split(">", 1)
    return f"{head}>{options}{tail}"


def _add_shapes(spec: mujoco.MjSpec, description: ArmDescription) -> None:
    for i, mesh in enumerate(description.meshes):
        name = f"{PREFIX}{mesh.link}_mesh_{i}"
        visual = spec.add_mesh(name=name, uservert=mesh.vertices.ravel(), userface=mesh.triangles.ravel())
        corners = (mesh.vertices - mesh.vertices.mean(axis=0))[mesh.triangles]
        if thinness(mesh.vertices) or abs(np.linalg.det(corners).sum()) < MIN_VOLUME:
            visual.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # a screen, whose mass does not matter
        _link(spec, mesh.link).add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            **({"material": "plastic" if i % 2 else "aluminium"} if mesh.colour is None else {"rgba": mesh.colour}),
            group=_VISUAL_GROUP,
            contype=0,
            conaffinity=0,
            mass=0,
        )
    links_with_meshes = {mesh.link for mesh in description.meshes}
    for capsule in description.capsules:
        group = _COLLISION_GROUP if capsule.link in links_with_meshes else _VISUAL_GROUP
        _add_capsule(_link(spec, capsule.link), capsule, group)
    for first, second in description.collision_pairs:
        add_collision_pair(spec, collision_geom(first), collision_geom(second))


def add_collision_pair(spec: Any, first: str, second: str) -> None:
    """Let two geoms collide, by their names: links of an arm, the floor, obstacles."""
    spec.add_pair(geomname1=first, geomname2=second, solref=HARD[0], solimp=HARD[1])


def _link(spec: mujoco.MjSpec, link: str) -> Any:
    """Return the body of a link; MuJoCo merges a URDF's root link `world` with its own."""
    return spec.body(PREFIX + link) or spec.worldbody


def collision_geom(link: str) -> str:
    """Name of a link's capsule in the model, or of the floor."""
    return "floor" if link == FLOOR else f"{link}_collision"


def _add_capsule(body: Any, capsule: Capsule, group: int) -> None:
    length = np.linalg.norm(np.subtract(capsule.end, capsule.start))
    kind = mujoco.mjtGeom.mjGEOM_CAPSULE if length > 1e-6 else mujoco.mjtGeom.mjGEOM_SPHERE
    body.add_geom(
        name=collision_geom(capsule.link),
        type=kind,
        size=[capsule.radius, 0, 0],
        **({"fromto": [*capsule.start, *capsule.end]} if length > 1e-6 else {"pos": capsule.start}),
        group=group,
        material="aluminium",
        contype=0,
        conaffinity=0,
        mass=0,
    )


def _add_motors(spec: mujoco.MjSpec, description: ArmDescription) -> None:
    """Add a motor per joint, and a brake for each of its directions, which acts above the velocity limit only."""
    limits = description.limits
    joints = list(zip(description.joints, limits.effort, limits.velocity, strict=True))
    for name, effort, _ in joints:
        motor = spec.add_actuator(name=name, target=PREFIX + name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        motor.ctrlrange = [-effort, effort]
    for name, effort, velocity in joints:
        damping = BRAKE_GAIN * effort / velocity
        for direction, (low, high) in {1: (-2 * effort, 0.0), -1: (0.0, 2 * effort)}.items():
            brake = spec.add_actuator(target=PREFIX + name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            brake.gainprm = [0.0] * 10
            brake.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            brake.biasprm = [direction * damping * velocity, 0.0, -damping, *[0.0] * 7]
            brake.forcerange = [low, high]


def _add_servos(spec: mujoco.MjSpec, description: ArmDescription, inertia: Array) -> None:
    """Add two actuators per joint, driven by the command's velocity: an integrator to a position, and a feed-forward.

    Together they form a critically damped servo: force = kp (command - q) + kv (command velocity - q velocity).
    """
    limits = description.limits
    for i, name in enumerate(description.joints):
        position = spec.add_actuator(name=f"{name}_position", target=PREFIX + name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        position.set_to_intvelocity(kp=inertia[i] * SERVO_BANDWIDTH**2)
        position.actlimited = True
        position.actrange = [limits.lower[i], limits.upper[i]]
    for i, name in enumerate(description.joints):
        velocity = spec.add_actuator(name=f"{name}_velocity", target=PREFIX + name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        velocity.set_to_velocity(kv=2 * inertia[i] * SERVO_BANDWIDTH)
        velocity.ctrlrange = [-limits.velocity[i], limits.velocity[i]]


def _joint_inertia(model: mujoco.MjModel, description: ArmDescription) -> Array:
    """Return the largest inertia at each joint over random configurations, (dof,) kg m^2."""
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    mass = np.zeros((model.nv, model.nv))
    coupling, largest = description.coupling[0], np.zeros(description.dof)
    count = len(coupling)
    sliding, limits = [name in description.sliding for name in description.joints], description.limits
    for q in rng.uniform(-np.pi, np.pi, (200, description.dof)):
        data.qpos[:count] = description.all_positions(np.where(sliding, np.clip(q, limits.lower, limits.upper), q))
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass)
        largest = np.maximum(largest, np.diag(coupling.T @ mass[:count, :count] @ coupling))
    return largest

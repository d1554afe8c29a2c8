"""A control step of MuJoCo's physics, in one world after another: see `armctl.simulation.control_step`.

A model and the data on which worlds are stepped are a `StepBuffers`; a world's state is copied there and back.
"""

from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.kernels import mujoco_library as mj
from armctl.kernels.compiling import compiled, inlined
from armctl.kernels.drives import drive_joints
from armctl.kernels.target_distance import angle_between, distance_as_observed

STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
ROUNDING = 1e-9
"""s."""
Indices = NDArray[np.intp]


class StepBuffers(NamedTuple):
    """Buffers of one thread: a model, the same with a finer time step, and the data."""

    model: int
    finer: int
    data: int
    qpos: Array
    qvel: Array
    act: Array
    ctrl: Array
    torques: Array
    """`qfrc_actuator`."""
    sensors: Array
    positions: Array
    """`xpos`, (bodies, 3)."""
    rotations: Array
    """`xmat`, (bodies, 9)."""
    warnings: NDArray[np.int32]
    """Counts of warnings of bad positions, velocities and accelerations, (3,)."""
    body_positions: tuple[Array, Array]
    """`body_pos` of both models."""
    world_fields: Indices
    """Model fields that each world has, (k, 4): address of the first row, bytes of a row, addresses in both models."""
    outputs: Indices
    """Fields copied out after a control step, (k, 3): address in the data, bytes of a row, address of the first."""
    kinematic: bool
    """True if outputs and sensors depend on positions, velocities and contacts only, and not on forces."""
    last_state: Array
    """State (k,) that the data has after a control step, with what the next one begins with; (0,): none is kept."""


class Worlds(NamedTuple):
    """States of n worlds."""

    state: Array
    """(n, k) as MuJoCo has it."""
    good: Array
    """(n, k) the last state in which all numbers were finite."""
    unstable: NDArray[np.bool_]
    refined: NDArray[np.int32]
    """(n,) how many ticks of the last control step were repeated in finer steps."""


class HardImpact(NamedTuple):
    """Conditions under which a tick is repeated in finer steps, and speed limits in these."""

    columns: Indices
    """Columns (k,) of the state, which are between `lowest` and `highest` (k,) unless something was hit hard."""
    lowest: Array
    highest: Array
    depth: int
    """The sensor of the deepest contact's distance."""
    deepest: float
    """m."""
    steps: int
    """Finer steps in a physics step."""
    dofs: Indices
    bounds: Array
    """rad/s, of `dofs`."""


class Drives(NamedTuple):
    """Joints (k,) with the fields of `drives.DRIVE`, and the positions or velocities (n, k) that they are to have."""

    joints: NDArray[np.void]
    setpoints: Array
    to_positions: bool
    following_error: float
    """rad."""
    columns: Indices
    """Columns (k,) of the joints' positions in `qpos`."""


class Samples(NamedTuple):
    """Speeds (rad/s) and torques (N m) of `dofs` (k,) after each tick, (ticks, n, k)."""

    dofs: Indices
    speeds: Array
    torques: Array


class TargetQuery(NamedTuple):
    """Position of a body, its distance from its target after each tick, and whether a world stands still there.

    Where targets are poses, the distance is that of the positions, or `lever` times the angle between the orientations,
    whichever is larger.
    """

    body: int
    targets: Array
    """(ticks, n, 3) m, or (1, n, 3) if they stand still; (0, n, 3): there are none."""
    tolerance: float
    """m. A world stands still from the tick on after which the body is so near; negative: it goes on."""
    distances: Array
    """(ticks, n) m."""
    nearest: Array
    """(n,) m, the smallest of these."""
    positions: Array
    """(ticks, n, 3) m, of the body."""
    rotations: Array = np.zeros((0, 9))
    """(n, 9) rotation matrices of targets that are poses; (0, 9): they are positions."""
    lever: float = 0.0
    """m/rad."""


class ContactOutput(NamedTuple):
    """Contacts in finer steps: columns of the state with samples of k sensors, and their times, (k, samples)."""

    samples: Indices
    times: Indices
    touched: NDArray[np.bool_]
    """(n, k)."""


class PoseInput(NamedTuple):
    """Bodies (k,) that are at x, y (m) before each tick, (ticks, n, k, 2), and `body_pos` (n, bodies, 3) of worlds."""

    bodies: Indices
    positions: Array
    body_positions: Array


class Parts(NamedTuple):
    """Inputs and recordings of each tick."""

    drives: Drives
    samples: Samples
    target_query: TargetQuery
    contacts: ContactOutput
    poses: PoseInput


class Clock(NamedTuple):
    """Time in a control step: `ticks` of so many `substeps` of `timestep` s each."""

    ticks: int
    substeps: int
    timestep: float
    column: int
    """Column of the state with the time."""


@inlined
def was_hit_hard(impact, state, sensors):
    """Return True if a column of the state (k,) is out of its bounds or not a number, or a contact is deep."""
    usual = sensors[impact.depth] > -impact.deepest
    for i in range(len(impact.columns)):
        usual = usual and impact.lowest[i] < state[impact.columns[i]] < impact.highest[i]
    return not usual


@compiled
def step_finely(buffers, impact, steps):
    """Make `steps` finer ones, with bounds on speeds."""
    buffers.warnings[:] = 1
    for _ in range(steps):
        mj.step(buffers.finer, buffers.data)
        for k in range(len(impact.dofs)):
            speed = buffers.qvel[impact.dofs[k]]
            buffers.qvel[impact.dofs[k]] = min(max(speed, -impact.bounds[k]), impact.bounds[k])
    if buffers.kinematic:  # the next step computes other forces than those of motors
        mj.begin_step(buffers.model, buffers.data)
        mj.actuate(buffers.model, buffers.data)
    else:
        mj.forward(buffers.model, buffers.data)


@inlined
def sense(buffers):
    """Compute sensors and outputs of a state from which no step follows: what a step begins with, without forces."""
    if buffers.kinematic:
        mj.kinematics(buffers.model, buffers.data)
        mj.collide(buffers.model, buffers.data)
        mj.sense_positions(buffers.model, buffers.data)
        mj.body_velocities(buffers.model, buffers.data)
        mj.sense_velocities(buffers.model, buffers.data)
    else:
        mj.begin_step(buffers.model, buffers.data)


@inlined
def is_unstable(buffers):
    """Return True if MuJoCo has warned (counts start at 1), or its numbers are too large or not finite."""
    stable = True
    for count in buffers.warnings:
        stable = stable and count <= 1
    for position in buffers.qpos:
        stable = stable and abs(position) < mujoco.mjMAXVAL
    for velocity in buffers.qvel:
        stable = stable and abs(velocity) < mujoco.mjMAXVAL
    return not stable


@inlined
def drive(buffers, drives, world, positions, period):
    """Set the commands of motors for a tick of `period` s. `positions` (dof,) is room for those of the joints."""
    for i in range(len(positions)):
        positions[i] = buffers.qpos[drives.columns[i]]
    drive_joints(
        drives.joints, drives.setpoints[world], drives.to_positions, positions, buffers.act, buffers.ctrl,
        drives.following_error, period,
    )  # fmt: skip


@inlined
def make_steps(buffers, substeps, is_current, is_last):
    """Make `substeps` physics steps.

    With `is_current`, what a step begins with has been computed. With `is_last`, that of the next is not.
    """
    buffers.warnings[:] = 1
    if not is_current:
        mj.begin_step(buffers.model, buffers.data)
    for _ in range(substeps - 1):
        mj.end_step(buffers.model, buffers.data)
        mj.begin_step(buffers.model, buffers.data)
    mj.end_step(buffers.model, buffers.data)
    if is_last:
        sense(buffers)
    else:
        mj.begin_step(buffers.model, buffers.data)


@compiled
def move(buffers, poses, world, tick_number):
    """Put bodies where they are in a world during a tick."""
    for i in range(len(poses.bodies)):
        body = poses.bodies[i]
        for axis in range(2):
            coordinate = poses.positions[tick_number, world, i, axis]
            poses.body_positions[world, body, axis] = coordinate
            for positions in buffers.body_positions:
                positions[body, axis] = coordinate


@compiled
def record_contacts(contacts, world, row, since):
    """Note contacts in the samples that were taken after a time (s)."""
    for i in range(len(contacts.samples)):
        for k in range(contacts.samples.shape[1]):
            if row[contacts.times[i, k]] > since and row[contacts.samples[i, k]] > 0:
                contacts.touched[world, i] = True


@inlined
def sample(buffers, samples, target_query, world, tick_number):
    """Record speeds, torques and the distance after a tick. Returns whether the body is at its target."""
    for k in range(len(samples.dofs)):
        samples.speeds[tick_number, world, k] = buffers.qvel[samples.dofs[k]]
        samples.torques[tick_number, world, k] = buffers.torques[samples.dofs[k]]
    if not len(target_query.targets):
        return False
    for axis in range(3):
        target_query.positions[tick_number, world, axis] = buffers.positions[target_query.body, axis]
    target = target_query.targets[min(tick_number, len(target_query.targets) - 1), world]
    distance = distance_as_observed(buffers.positions[target_query.body], target)
    if len(target_query.rotations):
        angle = angle_between(buffers.rotations[target_query.body], target_query.rotations[world])
        distance = max(distance, target_query.lever * angle)
    target_query.distances[tick_number, world] = distance
    target_query.nearest[world] = distance if tick_number == 0 else min(distance, target_query.nearest[world])
    return distance <= target_query.tolerance


@inlined
def load(buffers, row, world):
    """Put the data into the state `row` of a world. Returns whether it was there, with what a step begins with."""
    fields, kept = buffers.world_fields, buffers.last_state
    is_current = len(kept) > 0 and mj.compare(row.ctypes.data, kept.ctypes.data, row.nbytes) == 0
    for i in range(len(fields)):
        first, size, field, finer_field = fields[i]
        is_current = is_current and mj.compare(first + world * size, field, size) == 0
        mj.copy(field, first + world * size, size)
        mj.copy(finer_field, first + world * size, size)
    if not is_current:
        mj.set_state(buffers.model, buffers.data, row.ctypes.data, STATE)
    return is_current


@compiled
def control_steps(ids, bound):
    """Advance worlds `ids` by a control step. Bound are `Clock`, `StepBuffers`, `Worlds`, `HardImpact` and `Parts`.

    All is one function: `bound.arguments`, given to another one at each tick, take 2 us more each time.
    """
    clock, buffers, worlds, impact, parts = bound.arguments
    model, data, moving = buffers.model, buffers.data, len(parts.poses.bodies) > 0
    period = clock.timestep * clock.substeps
    next_state, positions = np.empty(worlds.state.shape[1]), np.empty(len(parts.drives.joints))
    for world in ids:
        row, good = worlds.state[world], worlds.good[world]
        is_current = load(buffers, row, world)
        worlds.refined[world], standing = 0, False
        for k in range(clock.ticks):
            if not standing:
                if moving:
                    move(buffers, parts.poses, world, k)
                drive(buffers, parts.drives, world, positions, period)
                is_last = k == clock.ticks - 1 and not len(buffers.last_state)
                make_steps(buffers, clock.substeps, is_current and not moving, is_last or moving)
                is_current = True
                mj.get_state(model, data, next_state.ctypes.data, STATE)
                hit = was_hit_hard(impact, next_state, buffers.sensors)
                if hit:
                    mj.set_state(model, data, row.ctypes.data, STATE)
                    drive(buffers, parts.drives, world, positions, period)
                    step_finely(buffers, impact, clock.substeps * impact.steps)
                    mj.get_state(model, data, next_state.ctypes.data, STATE)
                    worlds.refined[world] += 1
                worlds.unstable[world] = standing = is_unstable(buffers)
                if standing:
                    mj.set_state(model, data, good.ctypes.data if k == 0 else row.ctypes.data, STATE)
                    mj.forward(model, data)
                    mj.get_state(model, data, next_state.ctypes.data, STATE)
                elif hit:
                    record_contacts(parts.contacts, world, next_state, row[clock.column] - ROUNDING)
                mj.copy(row.ctypes.data, next_state.ctypes.data, row.nbytes)
            if sample(buffers, parts.samples, parts.target_query, world, k):
                standing = True
        mj.copy(good.ctypes.data, row.ctypes.data, row.nbytes)
        mj.copy(buffers.last_state.ctypes.data, row.ctypes.data, buffers.last_state.nbytes)
        for i in range(len(buffers.outputs)):
            field, size, first = buffers.outputs[i]
            mj.copy(first + world * size, field, size)

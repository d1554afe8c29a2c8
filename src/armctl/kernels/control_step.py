"""A control step of MuJoCo's physics, in one world after another: see `armctl.simulation.control_step`.

It calls MuJoCo's library, by addresses of models and data. A model and the data on which worlds are stepped are a
`Bench`; a world's state is copied there and back.
"""

from pathlib import Path
from typing import NamedTuple

import llvmlite.binding
import mujoco
import numpy as np
from numba import types
from numpy.typing import NDArray

from armctl.kernels.compiling import compiled
from armctl.kernels.drives import drive_joints

STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
ROUNDING = 1e-9
"""s."""
Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class Bench(NamedTuple):
    """A model, the same with a finer time step, and the data of one thread."""

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
    places: Array
    """`xpos`, (bodies, 3)."""
    warnings: NDArray[np.int32]
    """Counts of warnings of bad positions, velocities and accelerations, (3,)."""
    body_places: tuple[Array, Array]
    """`body_pos` of both models."""
    own_fields: Indices
    """Model fields that each world has, (k, 4): address of the first row, bytes of a row, addresses in both models."""
    outputs: Indices
    """What is copied out after a control step, (k, 3): address in the data, bytes of a row, address of the first."""


class Worlds(NamedTuple):
    """What determines how n worlds go on."""

    state: Array
    """(n, k) as MuJoCo has it."""
    good: Array
    """(n, k) the last state in which all numbers were finite."""
    unstable: NDArray[np.bool_]
    refined: NDArray[np.int32]
    """(n,) how many ticks of the last control step were repeated in finer steps."""


class HardImpact(NamedTuple):
    """When a tick is repeated in finer steps, and how fast joints may be in these."""

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
    wanted: Array
    to_positions: bool
    following_error: float
    """rad."""


class Samples(NamedTuple):
    """Speeds (rad/s) and torques (N m) of `dofs` (k,) after each tick, (ticks, n, k)."""

    dofs: Indices
    speeds: Array
    torques: Array


class Watch(NamedTuple):
    """How far a body is from its target after each tick, and whether a world stands still when it is there."""

    body: int
    targets: Array
    """(ticks, n, 3) m, or (1, n, 3) if they stand still; (0, n, 3): there are none."""
    tolerance: float
    """m. A world stands still from the tick on after which the body is so near; negative: it goes on."""
    distances: Array
    """(ticks, n) m."""


class Touches(NamedTuple):
    """Contacts in finer steps: columns of the state with samples of k sensors, and their times, (k, samples)."""

    samples: Indices
    times: Indices
    noted: NDArray[np.bool_]
    """(n, k)."""


class Moves(NamedTuple):
    """Bodies (k,) that are at x, y (m) before each tick, (ticks, n, k, 2), and `body_pos` (n, bodies, 3) of worlds."""

    bodies: Indices
    places: Array
    body_places: Array


def _load_mujoco() -> None:
    folder = Path(mujoco.__file__).parent
    library = next(path for pattern in ("libmujoco.*", "mujoco.dll") for path in folder.glob(pattern))
    llvmlite.binding.load_library_permanently(str(library))


_load_mujoco()
_step = types.ExternalFunction("mj_step", types.void(types.intp, types.intp))
_begin_step = types.ExternalFunction("mj_step1", types.void(types.intp, types.intp))
_end_step = types.ExternalFunction("mj_step2", types.void(types.intp, types.intp))
_forward = types.ExternalFunction("mj_forward", types.void(types.intp, types.intp))
_get_state = types.ExternalFunction("mj_getState", types.void(types.intp, types.intp, types.intp, types.int32))
_set_state = types.ExternalFunction("mj_setState", types.void(types.intp, types.intp, types.intp, types.int32))
_copy = types.ExternalFunction("memcpy", types.intp(types.intp, types.intp, types.intp))


@compiled
def distance_as_observed(position, target):
    """Distance (m) of a position from a target (3,), rounded as they are observed."""
    square = 0.0
    for axis in range(3):
        offset = np.float64(np.float32(target[axis])) - np.float64(np.float32(position[axis]))
        square += offset * offset
    return np.sqrt(square)


@compiled
def distances_as_observed(positions, targets, distances):
    """The same of n positions and targets, (n, 3) each, into `distances` (n,)."""
    for i in range(len(distances)):
        distances[i] = distance_as_observed(positions[i], targets[i])


@compiled
def was_hit_hard(impact, state, sensors):
    """Whether a column of the state (k,) is not between its bounds, is no number, or a contact is deep."""
    usual = sensors[impact.depth] > -impact.deepest
    for i in range(len(impact.columns)):
        usual = usual and impact.lowest[i] < state[impact.columns[i]] < impact.highest[i]
    return not usual


@compiled
def step_finely(bench, impact, state, steps):
    """Make `steps` finer ones from `state`, with bounds on speeds."""
    _set_state(bench.model, bench.data, state.ctypes.data, STATE)
    bench.warnings[:] = 1
    for _ in range(steps):
        _step(bench.finer, bench.data)
        for k in range(len(impact.dofs)):
            speed = bench.qvel[impact.dofs[k]]
            bench.qvel[impact.dofs[k]] = min(max(speed, -impact.bounds[k]), impact.bounds[k])
    _forward(bench.model, bench.data)


@compiled
def is_unstable(bench):
    """Whether MuJoCo has warned, which counts on from 1, or its numbers are too large, or none."""
    stable = True
    for count in bench.warnings:
        stable = stable and count <= 1
    for position in bench.qpos:
        stable = stable and abs(position) < mujoco.mjMAXVAL
    for velocity in bench.qvel:
        stable = stable and abs(velocity) < mujoco.mjMAXVAL
    return not stable


@compiled
def tick(bench, impact, row, before, good, substeps, begun):
    """Make `substeps` physics steps. Returns whether they were repeated in finer ones, and whether all is stable.

    The state after them is written into `row` (k,), and into `good` (k,), which is taken back to if they are unstable.
    `before` (k,) is room for the state before them. If the step has `begun`, positions and velocities are current.
    """
    _get_state(bench.model, bench.data, before.ctypes.data, STATE)
    bench.warnings[:] = 1
    if not begun:
        _begin_step(bench.model, bench.data)
    for _ in range(substeps):
        _end_step(bench.model, bench.data)
        _begin_step(bench.model, bench.data)
    _get_state(bench.model, bench.data, row.ctypes.data, STATE)
    hit = was_hit_hard(impact, row, bench.sensors)
    if hit:
        step_finely(bench, impact, before, substeps * impact.steps)
        _get_state(bench.model, bench.data, row.ctypes.data, STATE)
    stable = not is_unstable(bench)
    if not stable:
        _set_state(bench.model, bench.data, good.ctypes.data, STATE)
        _forward(bench.model, bench.data)
        _get_state(bench.model, bench.data, row.ctypes.data, STATE)
    _get_state(bench.model, bench.data, good.ctypes.data, STATE)
    return hit, stable


@compiled
def move(bench, moves, world, tick_number):
    """Put bodies where they are in a world during a tick."""
    for i in range(len(moves.bodies)):
        body = moves.bodies[i]
        for axis in range(2):
            place = moves.places[tick_number, world, i, axis]
            moves.body_places[world, body, axis] = place
            for places in bench.body_places:
                places[body, axis] = place


@compiled
def note_touches(touches, world, row, since):
    """Note contacts in the samples that were taken after a time (s)."""
    for i in range(len(touches.samples)):
        for k in range(touches.samples.shape[1]):
            if row[touches.times[i, k]] > since and row[touches.samples[i, k]] > 0:
                touches.noted[world, i] = True


@compiled
def sample(bench, samples, watch, world, tick_number):
    """Record speeds, torques and the distance after a tick. Returns whether the body is at its target."""
    for k in range(len(samples.dofs)):
        samples.speeds[tick_number, world, k] = bench.qvel[samples.dofs[k]]
        samples.torques[tick_number, world, k] = bench.torques[samples.dofs[k]]
    if not len(watch.targets):
        return False
    target = watch.targets[min(tick_number, len(watch.targets) - 1), world]
    distance = distance_as_observed(bench.places[watch.body], target)
    watch.distances[tick_number, world] = distance
    return distance <= watch.tolerance


@compiled
def control_steps(
    ids, ticks, substeps, bench, worlds, impact, drives, samples, watch, touches, moves, time_column, timestep
):
    """Advance worlds `ids` by `ticks` of `substeps` physics steps (s) each: all arguments are in this module."""
    before = np.empty(worlds.state.shape[1])
    for world in ids:
        row, good = worlds.state[world], worlds.good[world]
        for i in range(len(bench.own_fields)):
            first, size, field, finer_field = bench.own_fields[i]
            _copy(field, first + world * size, size)
            _copy(finer_field, first + world * size, size)
        _set_state(bench.model, bench.data, row.ctypes.data, STATE)
        worlds.refined[world], standing, moving = 0, False, len(moves.bodies) > 0
        for k in range(ticks):
            if not standing:
                if moving:
                    move(bench, moves, world, k)
                start = row[time_column]
                drive_joints(
                    drives.joints, drives.wanted[world], drives.to_positions, bench.qpos, bench.act, bench.ctrl,
                    drives.following_error, timestep * substeps,
                )  # fmt: skip
                hit, stable = tick(bench, impact, row, before, good, substeps, k > 0 and not moving)
                worlds.refined[world] += hit
                worlds.unstable[world] = standing = not stable
                if hit and stable:
                    note_touches(touches, world, row, start - ROUNDING)
            if sample(bench, samples, watch, world, k):
                standing = True
        for i in range(len(bench.outputs)):
            field, size, first = bench.outputs[i]
            _copy(first + world * size, field, size)

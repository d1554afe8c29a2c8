"""Arm descriptions: `load_arm` reads a URDF, xacro or MJCF into an `ArmDescription`.

Pinocchio and MuJoCo both build their models from it, so they cannot disagree.
"""

import functools
import itertools
import sysconfig
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Unpack

import numpy as np
import pinocchio
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.kernels.drives import DRIVE
from armctl.robot_description.builtin import BUILTIN_ARMS, MAX_ACCELERATION
from armctl.robot_description.capsules import Capsule, enclosing_capsule
from armctl.robot_description.collision_pairs import CollisionPairs, Pair, pairs_worth_testing, posture_above_floor
from armctl.robot_description.drawn_shapes import drawn_shapes
from armctl.robot_description.effort import possible_accelerations
from armctl.robot_description.followers import Follower
from armctl.robot_description.joint_limits import OverrideOptions, Overrides, as_tuple
from armctl.robot_description.notes import (
    in_words,
    note_on_home,
    notes_on_assumptions,
    notes_on_model,
    notes_on_pairs,
    tell,
)
from armctl.robot_description.shape import Shape
from armctl.robot_description.source import existing, open_robot, robot_file
from armctl.robot_description.urdf import Urdf
from armctl.robot_description.xml_file import impossible_pairs

MAX_JERK = 300.0
"""rad/s^3: default; reaches that acceleration within 50 ms"""


@dataclass(frozen=True, eq=False)
class JointLimits:
    """Limits of each joint, all (dof,): rad, rad/s, N m, rad/s^2, rad/s^3."""

    lower: Array
    upper: Array
    velocity: Array
    effort: Array
    acceleration: Array
    jerk: Array

    @functools.cached_property
    def drives(self) -> NDArray[np.void]:
        """The same as `armctl.kernels.drives` takes them, (dof,)."""
        drives = np.zeros(len(self.lower), DRIVE)
        drives["lower"], drives["upper"] = self.lower, self.upper
        drives["top"], drives["acceleration"] = self.velocity, self.acceleration
        return drives


@dataclass(frozen=True, eq=False)
class ArmDescription:
    """A serial arm: one URDF text for all libraries, and what a URDF does not contain.

    In `urdf` the joints from root to `tip` are movable, all others are fixed, and there is no geometry. `meshes` are
    visual only: what a file draws of a link, or else its collision shapes. Collisions are those of the `capsules`, one
    per link with a collision shape, in the pairs `collision_pairs`.
    """

    name: str
    urdf: str
    joints: tuple[str, ...]
    tip: str
    home: Array
    limits: JointLimits
    capsules: tuple[Capsule, ...]
    meshes: tuple[Shape, ...]
    collision_pairs: tuple[Pair, ...]
    notes: tuple[str, ...] = ()
    """Repairs, omissions and assumptions of the reader of a file, a sentence each; none for named arms."""
    sliding: tuple[str, ...] = ()
    """Joints that slide: for rad in their limits, read m, and for N m, N."""
    armature: tuple[float, ...] = ()
    """Inertia of each joint's motor, kg m^2; empty: none."""
    followers: tuple[Follower, ...] = ()
    """Further joints from root to tip, which have no motor; only `urdf`, capsules and meshes know of them."""

    @property
    def dof(self) -> int:
        """Number of joints with a motor."""
        return len(self.joints)

    @functools.cached_property
    def coupling(self) -> tuple[Array, Array]:
        """Matrix (m, dof) and offset (m,) that give the positions of all m joints from root to tip."""
        matrix, offset = np.eye(self.dof), np.zeros(self.dof)
        for follower in self.followers:
            row = follower.ratio * np.eye(self.dof)[self.joints.index(follower.leader)]
            matrix = np.insert(matrix, follower.place, row, axis=0)
            offset = np.insert(offset, follower.place, follower.offset)
        return matrix, offset

    def all_positions(self, q: Array) -> Array:
        """Return the positions (..., m) of all joints from root to tip, at q (..., dof)."""
        matrix, offset = self.coupling
        return np.asarray(q @ matrix.T + offset) if self.followers else q


@functools.cache
def robot_data() -> Path:
    """Return the folder of example-robot-data's robots."""
    relative = Path("cmeel.prefix/share/example-robot-data/robots")
    for site in (sysconfig.get_path("platlib"), sysconfig.get_path("purelib"), *pinocchio.__path__):
        for folder in (Path(site), *Path(site).parents):
            if (folder / relative).is_dir():
                return folder / relative
    raise ConfigurationError("example-robot-data is not installed beside armctl: pip install example-robot-data")


def load_arm(
    robot: "str | Path | ArmDescription",
    *,
    tip: str | None = None,
    home: Sequence[float] | Array | None = None,
    srdf: str | Path | None = None,
    **options: Unpack[OverrideOptions],
) -> ArmDescription:
    """Read an arm by name (one of `BUILTIN_ARMS`) or from a file: URDF, xacro or MJCF.

    `menagerie:NAME` is a robot of MuJoCo Menagerie, which the package mujoco-menagerie fetches.

    `tip` is the end-effector link; the default is a file's only leaf link, or one with a usual name. `home` (dof,) rad
    is where episodes start; the default is an MJCF's keyframe, or zero, or the middle of the range where zero is out of
    range, or a posture above the floor if links are in it otherwise. `srdf` is a file whose `<disable_collisions>`
    exclude pairs of links that cannot touch.

    Limits are one number for all joints or one for each. `max_acceleration` (rad/s^2) and `max_jerk` (rad/s^3) are not
    in files: the defaults are `MAX_JERK`, and a named arm's own accelerations, or what a file's efforts allow, up to
    `MAX_ACCELERATION`. `max_velocity` (rad/s) and `max_effort` (N m) lower those of a file, and stand in for missing
    ones. `density` (kg/m^3) gives links without a possible mass or inertia that of their collision shapes.

    A file may come from a stranger. Meshes are read only below its own package: the nearest folder above it with a
    `package.xml`; or else the folder that holds its folder `urdf`, `robots` or `mjcf`; or else its own folder.

    Raises `ConfigurationError` for an unknown name, for a file that is malformed or too large, and for one without the
    parts of a reach arm: at least one revolute joint between root and tip, with position limits, and mass behind each
    joint.
    """
    overrides = Overrides.of(dict(options))
    if isinstance(robot, ArmDescription):
        if any(option is not None for option in (tip, home, srdf)) or overrides != Overrides():
            raise ConfigurationError(
                f"the arm {robot.name!r} is loaded already: pass the options to the load_arm call that loads it"
            )
        return robot
    builtin = BUILTIN_ARMS.get(robot) if isinstance(robot, str) else None
    if builtin is not None:
        path, tip, srdf = robot_data() / builtin.urdf, tip or builtin.tip, srdf or robot_data() / builtin.srdf
        home = builtin.home if home is None else home
        if overrides.max_acceleration is None:
            overrides = replace(overrides, max_acceleration=as_tuple("max_acceleration", builtin.max_acceleration))
    elif not isinstance(robot, (str, Path)):
        raise ConfigurationError(f"robot should be a name, a path or an ArmDescription, not {robot!r}")
    else:
        path = robot_file(robot)
    srdf = None if srdf is None else existing(Path(srdf))
    edited = tuple(file.stat().st_mtime_ns for file in (path, srdf) if file is not None)
    home = None if home is None else as_tuple("home", home)
    return _read_arm(path, edited, tip, home, srdf, overrides, builtin is not None)


@functools.lru_cache(maxsize=16)
def _read_arm(
    path: Path,
    edited: tuple[int, ...],
    tip: str | None,
    home: tuple[float, ...] | None,
    srdf: Path | None,
    overrides: Overrides,
    builtin: bool,
) -> ArmDescription:
    """Read a file; `edited` (ns) tells its versions apart in the cache. Only an arm that is not `builtin` has notes."""
    source = open_robot(path, tip, overrides, robot_data().parent)
    dof, text = len(source.joints), source.text()
    armature = np.array([source.armature.get(joint, 0.0) for joint in source.joints])
    acceleration = overrides.limit("max_acceleration", dof)
    if acceleration is None:
        acceleration = possible_accelerations(text, MAX_ACCELERATION, armature).round(2)
    jerk = overrides.limit("max_jerk", dof)
    jerk = np.full(dof, MAX_JERK) if jerk is None else jerk
    joint_limits = JointLimits(*_frozen(*source.limits, acceleration, jerk))
    (home_position,) = _frozen(_home_position(_keyframe(source) if home is None else home, joint_limits))
    shapes = source.shapes
    capsules = tuple(
        enclosing_capsule(link, np.vstack([shape.vertices for shape in parts]))
        for link, parts in itertools.groupby(shapes, key=lambda shape: shape.link)
    )
    home_position, pairs = _posture(source, capsules, home_position, home is None, srdf)
    assumed = notes_on_assumptions(
        home_position if home is None and not _keyframe(source) else None,
        acceleration if overrides.max_acceleration is None else None,
        MAX_JERK if overrides.max_jerk is None else None,
    )
    meshes = tuple(shape for shape in shapes if len(shape.triangles)) if builtin else drawn_shapes(source, shapes)
    on_model = notes_on_model(text, source.tip, capsules)
    notes = () if builtin else (*source.notes, *on_model, *notes_on_pairs(pairs), *assumed)
    tell(path, notes)
    return ArmDescription(
        name=source.name,
        urdf=text,
        joints=source.joints,
        tip=source.tip,
        home=home_position,
        limits=joint_limits,
        capsules=capsules,
        meshes=meshes,
        collision_pairs=pairs.tested,
        notes=notes,
        sliding=source.sliding,
        armature=tuple(armature.tolist()) if armature.any() else (),
        followers=source.followers,
    )


def _keyframe(source: Urdf) -> tuple[float, ...] | None:
    """Return where the file has the arm begin, if that is within the limits of its joints."""
    lower, upper, *_ = source.limits
    position = np.array([source.home.get(joint, np.nan) for joint in source.joints])
    return tuple(position.tolist()) if ((lower <= position) & (position <= upper)).all() else None


def _posture(
    source: Urdf, capsules: tuple[Capsule, ...], home: Array, may_move: bool, srdf: Path | None
) -> tuple[Array, CollisionPairs]:
    """Return a home above the floor, another one than `home` (dof,) if it `may_move`, and the pairs to test there."""
    impossible, text = source.apart | (impossible_pairs(srdf) if srdf else set()), source.text()
    try:
        pairs = pairs_worth_testing(text, capsules, home, impossible)
        if pairs.floor_depths and may_move:
            above = posture_above_floor(text, capsules, home, pairs)
            if above is not None:
                source.notes.append(note_on_home(above, pairs.floor_depths))
                (home,) = _frozen(above)
                pairs = pairs_worth_testing(text, capsules, home, impossible)
    except (ValueError, RuntimeError) as error:
        raise ConfigurationError(f"{source.path.name} is not an arm that Pinocchio can model: {error}") from error
    if pairs.floor_depths:
        raise ConfigurationError(
            f"{source.path.name} begins in the floor, the plane z = 0: at home, the capsules of these links are in it: "
            f"{in_words(pairs.floor_depths)}. Give another home, in rad (`--set home=0,-1.2,...`, "
            "load_arm(home=...)), or a root link that is higher."
        )
    return home, pairs


def _home_position(home: tuple[float, ...] | None, limits: JointLimits) -> Array:
    if home is None:
        zero_allowed = (limits.lower <= 0) & (limits.upper >= 0)
        return np.where(zero_allowed, 0.0, (limits.lower + limits.upper) / 2)
    position = np.array(home, dtype=float)
    if position.shape != limits.lower.shape:
        raise ConfigurationError(f"home should have shape {limits.lower.shape}, not {position.shape}")
    if not np.all((position >= limits.lower) & (position <= limits.upper)):
        raise ConfigurationError(f"home {position} is outside the joint limits {limits.lower} to {limits.upper}")
    return position


def _frozen(*arrays: Array) -> tuple[Array, ...]:
    """Return read-only copies, since descriptions are shared."""
    copies = tuple(np.array(array) for array in arrays)
    for copy in copies:
        copy.flags.writeable = False
    return copies

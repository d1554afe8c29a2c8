"""Reach: bring the arm's end-effector to a target that is at a new place each episode."""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.assets import ArmDescription, load_arm
from armctl.drives import TICK
from armctl.errors import ConfigurationError, unknown_name
from armctl.kinematics import THOROUGH, ArmModel, SoonestTouch, Workspace
from armctl.robots import Arm, build_arm_world
from armctl.simulation import Simulation
from armctl.tasks.task import Motion, Outcome, RewardLedger, Task

Array = NDArray[np.float64]

DECISION_PERIOD = 0.04
"""Seconds between decisions: 25 Hz."""


@dataclass(frozen=True)
class ReachState:
    """All that reward and observation terms may use, for n worlds; rad, rad/s, m."""

    end_effector_position: Array
    """(n, 3)"""
    joint_positions: Array
    """(n, dof)"""
    joint_velocities: Array
    """(n, dof)"""
    target_position: Array
    """(n, 3)"""
    distance: Array
    """(n,) from the end-effector to the target's centre."""
    previous_distance: Array
    """(n,) the same, one decision earlier."""
    reached: NDArray[np.bool_]
    """(n,) whether the end-effector has been within the tolerance of the target since the last decision."""
    target_velocity: Array
    """(n, 3) m/s."""
    action: Array
    """(n, dof) the last action, as the policy gave it."""


Worlds = NDArray[np.int32] | slice
Term = Callable[[ReachState], NDArray[np.floating[Any]]]

OBSERVATION: Mapping[str, Term] = {
    "end_effector_position": lambda state: state.end_effector_position,
    "joint_positions": lambda state: state.joint_positions,
    "target_position": lambda state: state.target_position,
}
"""The parts of an observation, in order."""

REWARD: Mapping[str, Term] = {
    "step": lambda state: np.full(len(state.reached), -1.0),
    "goal": lambda state: 100.0 * state.reached,
}
"""The terms of the reward, whose sum is the reward."""


@dataclass(frozen=True)
class ReachOptions:
    """Options of `armctl/ArmReach-v0`; raises `ConfigurationError` for values it cannot take."""

    robot: str | Path | ArmDescription = "ur5"
    """`ur3`, `ur5`, `ur10`, the path of a URDF file, or what `armctl.load_arm` returned."""
    tip: str | None = None
    """The link that is the end-effector, where a URDF file has several that could be."""
    control: str = "position"
    """What an action is: `position`, `delta`, `velocity` or `torque` (see `armctl.robots.Arm`)."""
    tolerance: float = 0.05
    """Radius of the target sphere, m: within it, the target is reached."""
    target: str = "reachable"
    """`reachable`: uniform over where the arm can be. `box`: uniform in `target_box`; `info["feasible"]` then tells."""
    target_box: tuple[tuple[float, float, float], tuple[float, float, float]] = ((-1.0, -1.0, 0.05), (1.0, 1.0, 1.0))
    """Lowest and highest corner of the box, m."""
    reward: Mapping[str, Term] = field(default_factory=lambda: REWARD)
    """Named reward terms."""
    observation: Mapping[str, Term] = field(default_factory=lambda: OBSERVATION)
    """Named parts of the observation, in order."""

    def __post_init__(self) -> None:
        if not (isinstance(self.tolerance, (int, float)) and np.isfinite(self.tolerance) and self.tolerance > 0):
            raise ConfigurationError(f"tolerance is a distance above 0 m, not {self.tolerance!r}")
        if self.target not in ("reachable", "box"):
            raise unknown_name("target", self.target, ("reachable", "box"))
        if not _is_box(self.target_box):
            raise ConfigurationError(f"target_box is its lowest and highest corner (x, y, z), not {self.target_box}")
        for name, terms in (("reward", self.reward), ("observation", self.observation)):
            if not isinstance(terms, Mapping) or not terms or not all(callable(term) for term in terms.values()):
                raise ConfigurationError(
                    f"{name} is a mapping from names to functions, at least one term, not {terms!r}"
                )


def _is_box(box: Any) -> bool:
    try:
        corners = np.asarray(box, dtype=float)
    except (TypeError, ValueError):
        return False
    return corners.shape == (2, 3) and bool((corners[0] <= corners[1]).all())


class ReachTask(Task):
    """n arms, each with its target."""

    camera = "overview"

    def __init__(self, n: int, options: ReachOptions, threads: int = 0) -> None:
        self.options = options
        description = load_arm(options.robot) if options.tip is None else load_arm(options.robot, tip=options.tip)
        model = self._build(description)
        model.geom("target").size[:] = options.tolerance
        self.simulation = Simulation(model, n, threads)
        self.substeps = round(DECISION_PERIOD / model.opt.timestep)
        self.arm = Arm(self.simulation, description, options.control, DECISION_PERIOD)
        self.joints = self.arm.joints
        self._workspace = Workspace(ArmModel(description))
        self.simulation.model.camera(self.camera).pos[:] *= self._workspace.radius  # the MJCF's suits a reach of 1 m
        self._targets = self.simulation.array("mocap_pos")[:, 0]
        self._target_velocities = np.zeros((n, 3))
        self._feasible = np.ones(n, dtype=bool)
        self._action = np.zeros((n, description.dof))
        self._distance, self._nearest = np.zeros(n), np.full(n, np.inf)
        self._attach()
        self.simulation.reset()
        self.simulation.refresh()
        self._look(self._action)
        self._check_terms(n)
        low, high = np.float32(self.arm.action_low), np.float32(self.arm.action_high)
        self.action_space = gymnasium.spaces.Box(low, high, dtype=np.float32)
        size = self.observe().shape[1:]
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, size, dtype=np.float32)

    @property
    def interface(self) -> dict[str, str]:
        """Robot, control, and the parts of the observation."""
        return {
            "robot": self.arm.description.name,
            "control": self.arm.control,
            "observation": ", ".join(self.options.observation),
        }

    def reset(self, ids: NDArray[np.int32], rngs: list[np.random.Generator]) -> None:
        """Arms go home, and targets to new places."""
        self.simulation.reset(ids)
        for i, rng in zip(ids, rngs, strict=True):
            self._draw(int(i), rng)
        self.simulation.refresh(ids)
        self._action[ids], self._nearest[ids] = 0.0, self._distances()[ids]
        self._look(self._action)
        self._distance[ids] = self.state.distance[ids]

    def command(self, actions: Array) -> None:
        """Actions (n, dof), in the unit of `ReachOptions.control`."""
        self._action = actions
        self._distance = self.state.distance
        self.arm.command(actions)

    def advance(self, ids: NDArray[np.int32] | None) -> None:
        """Let time go on until the next decision, in worlds `ids` or in all."""
        ticks = round(DECISION_PERIOD / TICK)
        self._nearest = np.full_like(self._distance, np.inf)
        for _ in range(ticks):
            self.arm.drive()
            self.simulation.step(self.substeps // ticks, ids)
            self.joints.take()
            self._tick(slice(None) if ids is None else ids)

    def parts(self) -> dict[str, NDArray[np.floating[Any]]]:
        """The parts of `ReachOptions.observation`, (n, k) each."""
        return {name: part(self.state) for name, part in self.options.observation.items()}

    def observe(self, ids: NDArray[np.int32] | None = None) -> NDArray[np.float32]:
        """Observations (n, k): the parts side by side."""
        observations = np.concatenate(list(self.parts().values()), axis=1, dtype=np.float32)
        return observations if ids is None else observations[ids]

    def score(self) -> RewardLedger:
        """The terms of `ReachOptions.reward`."""
        self._look(self._action)
        return {name: np.array(term(self.state), dtype=float) for name, term in self.options.reward.items()}

    def outcome(self) -> NDArray[np.int8]:
        """`REACHED`, or `TIMEOUT` as long as it is not."""
        return self.state.reached * np.int8(Outcome.REACHED)

    def details(self) -> dict[str, NDArray[Any]]:
        """`feasible`: whether the arm can reach the target (see `armctl.kinematics.Workspace.reachable`)."""
        return {"feasible": self._feasible.copy()}

    def least_time(self, world: int) -> float:
        """Seconds in which the joints' limits allow a touch, if nothing stands in the way."""
        q, velocity, target = (
            array[world] for array in (self.arm.joint_positions, self.arm.joint_velocities, self._targets)
        )
        return self._soonest.least_time(q, target, self.options.tolerance, velocity)

    def motion(self) -> Motion:
        """How the arms move now; a contact is one of the arm with the floor or itself, now."""
        arm = self.arm
        return Motion(
            arm.end_effector_positions.copy(),
            arm.joint_positions.copy(),
            self.joints.since_last_decision(),
            self._contact(),
        )

    @functools.cached_property
    def _soonest(self) -> SoonestTouch:
        return SoonestTouch(self._workspace.model, THOROUGH)

    def _check_terms(self, n: int) -> None:
        for name, earned in self.score().items():
            if earned.shape != (n,):
                raise ConfigurationError(f"the reward term {name!r} is one number a world, ({n},), not {earned.shape}")
        for name, part in self.parts().items():
            if part.ndim != 2 or len(part) != n:
                raise ConfigurationError(f"the observation's {name!r} has shape ({n}, k), not {np.shape(part)}")

    def _build(self, description: ArmDescription) -> mujoco.MjModel:
        return build_arm_world(description, self.options.control)

    def _attach(self) -> None:
        """Get hold of what else is in the simulation."""
        self._contacts = self.simulation.array("ncon")

    def _contact(self) -> NDArray[np.bool_]:
        """(n,) whether the arm touches what it must not."""
        return np.asarray(self._contacts > 0)

    def _draw(self, world: int, rng: np.random.Generator) -> None:
        """Draw what is new in a world's episode."""
        if self.options.target == "box":
            self._targets[world] = rng.uniform(*self.options.target_box)
            self._feasible[world] = self._workspace.reachable(self._targets[world], self.options.tolerance)
        else:
            self._targets[world] = self._workspace.sample(rng, clearance=self.options.tolerance)

    def _tick(self, worlds: Worlds) -> None:
        """Take note of what the drives' last tick has brought in these worlds."""
        self._nearest = np.minimum(self._nearest, self._distances())

    def _look(self, action: Array) -> None:
        self.state = ReachState(
            self.arm.end_effector_positions,
            self.arm.joint_positions,
            self.arm.joint_velocities,
            self._targets,
            self._distances(),
            self._distance,
            self._nearest <= self.options.tolerance,
            self._target_velocities,
            action,
        )

    def _distances(self) -> Array:
        offset = self._targets - self.arm.end_effector_positions
        return np.asarray(np.sqrt((offset * offset).sum(axis=1)))

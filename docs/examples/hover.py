"""Hover: a quadrotor flies to a target and stops there. A task, its expert and its potential, in one file."""

import functools
from typing import Annotated

import gymnasium
import mujoco
import numpy as np
from pydantic import Field

from armctl import Task, register
from armctl.core.options import options
from armctl.disturbances import GENERIC, DisturbanceSpec, Payload, Pushes
from armctl.simulation import Simulation
from armctl.simulation.planning_model import motor_worlds
from armctl.tasks import MotionSample, Outcome, Potential

WORLD = """
<mujoco>
  <option timestep="0.004" integrator="implicitfast"/>
  <worldbody> <light pos="0 0 4"/>
    <camera name="overview" pos="0 -4 2" xyaxes="1 0 0 0 0.3 1"/>
    <geom name="floor" type="plane" size="5 5 0.1" rgba="0.7 0.75 0.8 1"/>
    <body name="target" mocap="true">
      <geom size="0.1" rgba="0 0.8 0 0.5" contype="0" conaffinity="0"/>
    </body>
    <body name="quadrotor" pos="0 0 1">
      <freejoint/>
      <geom type="box" size="0.12 0.12 0.03" mass="1" rgba="0.95 0.5 0.1 1"/>
      <site name="front_left" pos="0.1 0.1 0"/>
      <site name="front_right" pos="0.1 -0.1 0"/>
      <site name="rear_left" pos="-0.1 0.1 0"/>
      <site name="rear_right" pos="-0.1 -0.1 0"/>
    </body>
  </worldbody> <actuator>
    <motor site="front_left" gear="0 0 1 0 0 0.02"/>
    <motor site="front_right" gear="0 0 1 0 0 -0.02"/>
    <motor site="rear_left" gear="0 0 1 0 0 -0.02"/>
    <motor site="rear_right" gear="0 0 1 0 0 0.02"/>
  </actuator> <keyframe> <key name="start" qpos="0 0 1 1 0 0 0"/> </keyframe>
</mujoco>"""
MASS, ARM, YAW_TORQUE, MAX_THRUST, GRAVITY = 1.0, 0.1, 0.02, 6.0, 9.81
# Rotors by lift, roll, pitch, yaw.
MIXER = np.array([(1, 1, -1, 1), (1, -1, -1, -1), (1, 1, 1, -1), (1, -1, 1, 1)])


@options
class HoverOptions:
    """Options of `mine/Hover-v0`."""

    tolerance: Annotated[float, Field(gt=0)] = 0.1
    """Distance to the target, m, within which less than 0.5 m/s is to hover."""


class HoverOutcome(Outcome):
    """Endings of an episode; True marks a success."""

    TIMEOUT = 0
    HOVERING = 1, True
    CRASHED = 2


class TimeToGo(Potential):
    """A potential: minus the seconds to the target and to slow down."""

    def potentials(self, ids):
        """Return minus the time (len(ids),) to the target, s."""
        speeds = np.linalg.norm(self.task.velocities[ids], axis=1)
        return -self.task.goal_distances()[ids] - speeds


class HoverTask(Task):
    """n quadrotors, each with its target."""

    options_type = HoverOptions
    outcomes = HoverOutcome
    default_policies = ("hover:Expert", "random")
    potentials = Task.potentials | {"time": TimeToGo}
    disturbances = GENERIC | {
        "payload": DisturbanceSpec(
            Payload,
            "a ball in the middle",
            "kg",
            (0, 0.1, 0.2, 0.5),
            highest=2.0,
        ),
        "pushes": DisturbanceSpec(
            Pushes,
            "pushes, about one a second",
            "N s",
            (0, 0.5, 1, 2),
            highest=10.0,
        ),
    }
    payload_body = "quadrotor"
    idle_action = np.full(4, MASS * GRAVITY / 4)
    render_fps = 50

    def __init__(self, n, options, threads=0):
        super().__init__(
            Simulation(mujoco.MjModel.from_xml_string(WORLD), n, threads),
            control_period=0.02,
        )
        array = self.simulation.array
        self._qpos, self._qvel, self._rotations = map(
            array, ("qpos", "qvel", "xmat")
        )
        self._thrusts, self._contacts = array("ctrl"), array("ncon")
        self._targets = array("mocap_pos")
        self.rollout_worlds = functools.partial(
            motor_worlds, substeps=self.substeps, lower=0, upper=MAX_THRUST
        )
        self.options, self.velocities = options, self._qvel[:, :3]
        self.action_space = gymnasium.spaces.Box(0.0, MAX_THRUST, (4,))
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (18,))

    def reset(self, ids, rngs):
        """Put quadrotors at the origin, and targets at random around them."""
        self.simulation.reset(ids)
        self._targets[ids, 0] = [
            rng.uniform((-1, -1, 0.5), (1, 1, 2)) for rng in rngs
        ]
        self.simulation.refresh(ids)

    def command(self, actions):
        """Set thrusts (n, 4), N."""
        self._thrusts[:] = np.clip(actions, 0.0, MAX_THRUST)

    def observe(self, ids=None):
        """Return offset, rotation matrix, velocity and body rates: (n, 18), SI."""
        rotations = self._rotations[:, -1].reshape(-1, 9)
        seen = np.concatenate(
            (self._offsets(), rotations, self._qvel), axis=1, dtype=np.float32
        )
        return seen if ids is None else seen[ids]

    def reward_terms(self):
        """Return -1 for each step, 100 for hovering and -100 for a crash."""
        outcome = self.outcome()
        return {
            "step": np.full(self.n, -1.0),
            "goal": np.where(outcome == HoverOutcome.HOVERING, 100.0, 0.0),
            "crash": np.where(outcome == HoverOutcome.CRASHED, -100.0, 0.0),
        }

    def outcome(self):
        """Return `CRASHED` on the floor, `HOVERING` if near the target and slow."""
        slow = np.linalg.norm(self.velocities, axis=1) < 0.5
        hovering = (self.goal_distances() < self.options.tolerance) & slow
        return np.where(
            self._contacts > 0,
            HoverOutcome.CRASHED,
            hovering * HoverOutcome.HOVERING,
        )

    def goal_distances(self):
        """Return the distances (n,) to the targets, m."""
        return np.linalg.norm(self._offsets(), axis=1)

    def motion(self):
        """Return positions, poses and contacts, for the metrics."""
        return MotionSample(
            self._qpos[:, :3].copy(), self._qpos.copy(), self._contacts > 0
        )

    def _offsets(self):
        return self._targets[:, 0] - self._qpos[:, :3]


class Expert:
    """A cascade of PD controllers, of the acceleration and of the attitude."""

    sees, training_steps = "observation", 0

    def __init__(self, env):
        """Ignore the environment: the observation is enough."""

    def reset(self, ids):
        """Do nothing: it has no memory."""

    def act(self, observations):
        """Return thrusts (n, 4) for observations (n, 18)."""
        offset, rotation, velocity, rates = np.split(
            observations.astype(float), (3, 12, 15), axis=1
        )
        wanted = np.array((0, 0, GRAVITY)) + np.clip(
            4 * offset - 3 * velocity, -4, 4
        )
        body_frame = np.einsum("nij,ni->nj", rotation.reshape(-1, 3, 3), wanted)
        roll, pitch, yaw = (
            0.4 * np.cross((0, 0, 1), body_frame / GRAVITY) - 0.08 * rates
        ).T
        wrench = np.stack(
            (
                MASS * body_frame[:, 2],
                roll / ARM,
                pitch / ARM,
                yaw / YAW_TORQUE,
            ),
            axis=1,
        )
        return wrench @ MIXER.T / 4


register("mine/Hover-v0", HoverTask, max_episode_steps=250)

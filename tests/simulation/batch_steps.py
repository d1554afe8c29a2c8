"""What `armctl.simulation.control_step.Stepper` computes, readable, in all worlds at once, through `mujoco.batch`."""

import mujoco
import numpy as np

from armctl.kernels.control_step import ROUNDING
from armctl.kernels.drives import drive_joints
from armctl.simulation.control_step import NO_PARTS

CURRENT = int(mujoco.mjtStage.mjSTAGE_VEL)


class BatchSteps:
    """In place of the `Stepper` of a simulation, which it takes over: `BatchSteps.take_over(simulation)`."""

    def __init__(self, simulation):
        self.batch = simulation._batch
        self._impact, self._worlds = simulation._stepper._impact, simulation._stepper._worlds
        self._timestep = np.asarray(self.batch.expand("opt.timestep"))
        self._fields = {name: simulation.array(name) for name in ("qpos", "qvel", "act", "ctrl", "time")}
        self._outputs = {name: simulation.array(name) for name in ("sensordata", "qfrc_actuator", "xpos", "xmat")}

    @classmethod
    def take_over(cls, simulation):
        """Step a simulation that has just been made; returns what does it."""
        simulation._stepper, made = None, cls(simulation)
        simulation._stepper = made
        return made

    def add_output(self, field, values):
        """The batch fills its own arrays."""

    def step(self, ids, ticks, substeps, parts=NO_PARTS):
        """As `Stepper.step`."""
        drives, samples, target_query, contacts, poses = parts
        worlds, fields, refined = self._worlds, self._fields, np.zeros(len(self._worlds.refined), dtype=int)
        standing = np.ones(len(refined), dtype=bool)
        standing[ids] = False
        for k in range(ticks):
            going = np.flatnonzero(~standing).astype(np.int32)
            if len(poses.bodies):
                poses.body_positions[going[:, None], poses.bodies, :2] = poses.positions[k, going]
            for i in going:
                drive_joints(
                    drives.joints, drives.setpoints[i] if len(drives.joints) else np.zeros(0), drives.to_positions,
                    fields["qpos"][i][drives.columns[: len(drives.joints)]], fields["act"][i], fields["ctrl"][i],
                    drives.following_error, substeps * self.batch.model.opt.timestep,
                )  # fmt: skip
            start = fields["time"].copy()
            self.tick(substeps, going)
            hit = np.flatnonzero((worlds.refined > 0) & ~worlds.unstable)
            late = worlds.state[hit[:, None, None], contacts.times] > start[hit, None, None] - ROUNDING
            touching = worlds.state[hit[:, None, None], contacts.samples] > 0
            if contacts.touched.size:
                contacts.touched[hit] |= (late & touching).any(axis=-1)
            refined += worlds.refined
            standing |= worlds.unstable
            if samples.speeds.size:
                samples.speeds[k, ids] = fields["qvel"][ids][:, samples.dofs]
                samples.torques[k, ids] = self._outputs["qfrc_actuator"][ids][:, samples.dofs]
            if len(target_query.targets):
                target = np.float32(target_query.targets[min(k, len(target_query.targets) - 1)]).astype(float)
                offset = target - np.float32(self._outputs["xpos"][:, target_query.body])
                distances = np.sqrt((offset * offset).sum(axis=-1))
                if len(target_query.rotations):
                    rotations = self._outputs["xmat"].reshape(len(distances), -1, 9)[:, target_query.body]
                    turns = np.sqrt(((target_query.rotations - rotations) ** 2).sum(axis=-1) / 8)
                    distances = np.maximum(distances, 2 * target_query.lever * np.arcsin(np.minimum(turns, 1.0)))
                target_query.distances[k, ids] = distances[ids]
                standing |= distances <= target_query.tolerance
        worlds.refined[:] = refined

    def tick(self, substeps, ids):
        """Make some physics steps in worlds `ids`, or finer ones in which something was hit hard."""
        worlds, before = self._worlds, self._worlds.state.copy()
        self.batch.warning[:] = 0
        self.batch.step(ids, nstep=substeps, stage=CURRENT)
        worlds.refined[:] = 0
        worlds.refined[ids] = ~self._usual()[ids]
        hit = np.flatnonzero(worlds.refined).astype(np.int32)
        if len(hit):
            worlds.state[hit], self.batch.warning[hit] = before[hit], 0
            self._step_finely(substeps * self._impact.steps, hit)
        motion = np.hstack((self._fields["qpos"], self._fields["qvel"]))
        bad = self.batch.warning[:, :, 1].any(axis=1) | ~(np.abs(motion) < mujoco.mjMAXVAL).all(axis=1)
        bad = ids[bad[ids]]
        worlds.unstable[bad] = True
        worlds.state[bad] = worlds.good[bad]
        self.batch.forward(bad)
        worlds.good[ids] = worlds.state[ids]

    def _usual(self):
        impact = self._impact
        watched = self._worlds.state[:, impact.columns]
        within = ((impact.lowest < watched) & (watched < impact.highest)).all(axis=1)
        return within & (self._outputs["sensordata"][:, impact.depth] > -impact.deepest)

    def _step_finely(self, steps, ids):
        impact, velocities = self._impact, self._fields["qvel"]
        self._timestep[ids] /= impact.steps
        for _ in range(steps):
            self.batch.step(ids)
            bounded = np.clip(velocities[:, impact.dofs], -impact.bounds, impact.bounds)
            velocities[ids[:, None], impact.dofs] = bounded[ids]
        self._timestep[ids] *= impact.steps
        self.batch.forward(ids)

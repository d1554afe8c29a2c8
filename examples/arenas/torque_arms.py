"""Scripted experts of Gymnasium's `Reacher-v5` and `Pusher-v5`, whose actions are torques.

Both read the observation, and know the arm as MuJoCo's file describes it: lengths, joints and motors.
"""

import gymnasium
import mujoco
import numpy as np

LINKS = 0.1, 0.11
"""Lengths of Reacher's links, m."""
MOTOR = 200.0
"""rad/s^2 of a joint of Reacher's for an action of 1: gear over armature, beside which links weigh little."""


class Reacher:
    """Inverse kinematics of two links, and LQR of each joint.

    A joint is a double integrator. For costs of e^2 + r u^2 an instant, its feedback is u = k e - sqrt(2 k / MOTOR) v
    with k = r^-1/2.
    """

    sees = "model"
    gain = 0.3
    """k, 1/rad."""

    def act(self, observation):
        """Return the action for an observation."""
        angles = np.arctan2(observation[2:4], observation[:2])
        errors = min(
            (wrapped(q - angles) for q in self.solutions(observation[4:6])),
            key=np.linalg.norm,
        )
        damping = np.sqrt(2 * self.gain / MOTOR)
        return np.clip(self.gain * errors - damping * observation[6:8], -1, 1)

    def solutions(self, target):
        """Return the two solutions (2,) of inverse kinematics, rad."""
        first, second = LINKS
        cosine = target @ target - first**2 - second**2
        cosine = np.clip(cosine / (2 * first * second), -1, 1)
        for elbow in np.arccos(cosine), -np.arccos(cosine):
            across = second * np.sin(elbow)
            along = first + second * np.cos(elbow)
            bearing = np.arctan2(target[1], target[0])
            yield np.array([bearing - np.arctan2(across, along), elbow])


def wrapped(angle):
    """Return an angle between -pi and pi."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


class Pusher:
    """Leans the fork on the cylinder from behind: inverse kinematics by damped least squares, and computed torque.

    The cylinder gives way slowly, at most some 3 mm in a control step: it weighs 8 mg, and its joints are damped.
    """

    sees = "model"
    stiffness, damping = 7.0, 6.0
    """Of the joints, 1/s^2 and 1/s."""
    softness = 0.07
    """Damping of the least squares, m."""
    push, gap = 0.05, 0.05
    """m that the fork aims ahead of where it touches the cylinder, and from there to the cylinder's axis."""
    posture, pull = np.array([0, 0, -1.4, -1.2, 0, -0.2, 1.4]), 0.5
    """Angles (rad) that the arm, straight at first, bends to, as far as the fork need not move; 0 is any."""

    def __init__(self):
        self.model = gymnasium.make("Pusher-v5").unwrapped.model
        self.data = mujoco.MjData(self.model)
        self.fork = self.model.body("tips_arm").id

    def act(self, observation):
        """Return the action for an observation."""
        angles, speeds = observation[:7], observation[7:14]
        fork, cylinder, goal = observation[14:].reshape(3, 3)
        self.data.qpos[:7], self.data.qvel[:7] = angles, speeds
        mujoco.mj_forward(self.model, self.data)
        jacobian = np.zeros((3, self.model.nv))
        mujoco.mj_jacBody(self.model, self.data, jacobian, None, self.fork)
        jacobian = jacobian[:, :7]
        inverse = jacobian.T @ np.linalg.inv(
            jacobian @ jacobian.T + self.softness**2 * np.eye(3)
        )
        change = inverse @ (self.point(cylinder, goal) - fork)
        bend = self.pull * np.where(self.posture, self.posture - angles, 0)
        change += bend - inverse @ (jacobian @ bend)
        return self.torques(self.stiffness * change - self.damping * speeds)

    def point(self, cylinder, goal):
        """Return where the fork should be, m: behind the cylinder, and so far into it that it gives way."""
        way = goal - cylinder
        way[2] = 0.0
        distance = max(np.linalg.norm(way), 1e-9)
        return cylinder + (min(distance, self.push) - self.gap) * way / distance

    def torques(self, acceleration):
        """Return the torques (7,) of an acceleration of the joints, as far as the motors have them."""
        both = np.zeros((2, self.model.nv))
        both[0, :7] = acceleration
        mujoco.mj_mulM(self.model, self.data, both[1], both[0])
        torques = both[1] + self.data.qfrc_bias - self.data.qfrc_passive
        return np.clip(torques[:7], -2, 2)

"""Scripted experts of reach and push, for observations with goals: Fetch of Gymnasium-Robotics and Panda of panda-gym.

In both, an action of 1 moves the hand by 5 cm in a control step; a fourth action of Fetch, the gripper, stays 0.
"""

import numpy as np

STEP = 0.05
"""m that the hand moves for an action of 1."""
HEIGHT, ROOM, NEAR = 0.1, 0.02, 0.03
"""m that the hand passes above the cube; free space behind it; distance from the goal at which the hand stops."""
UP = np.array([0.0, 0.0, 1.0])
BRAKE = 1.5
"""Control steps that the cube's speed is taken to last."""


class Reach:
    """Moves straight to the goal."""

    def __init__(self, env):
        self.size = env.action_space.shape[0]

    def act(self, observation):
        """Return the action for an observation."""
        offset = observation["desired_goal"] - observation["achieved_goal"]
        return self.towards(offset)

    def towards(self, offset):
        """Return the action that moves the hand by an offset, m."""
        action = np.zeros(self.size)
        action[:3] = np.clip(offset / STEP, -1, 1)
        return action


class Push(Reach):
    """Passes above the cube, comes down behind it, and pushes it."""

    half, ahead = 0.025, 0.02
    """Half of the cube's edge; how far the hand aims beyond its face: both m."""

    def reset(self):
        """Begin an episode."""
        self.last = None

    def act(self, observation):
        """Return the action for an observation."""
        hand = observation["observation"][:3]
        cube = observation["achieved_goal"]
        speed = cube - (cube if self.last is None else self.last)
        self.last = cube
        way = observation["desired_goal"] - cube - BRAKE * speed
        way[2] = 0.0
        distance = np.linalg.norm(way)
        if distance < NEAR:
            return self.towards(np.zeros(3))
        way /= distance
        offset = hand - cube
        aside = offset - (offset @ way) * way
        aside[2] = 0.0
        is_behind = offset @ way < 0 and np.linalg.norm(aside) < self.half
        if is_behind and offset[2] < self.half:
            slow = 1 - np.linalg.norm(aside) / self.half
            ahead = slow * min(distance, self.ahead) - self.half
            return self.towards(ahead * way - aside - offset)
        behind = -1.5 * (self.half + ROOM) * way
        is_above = np.linalg.norm((behind - offset)[:2]) < self.half
        if is_above:
            return self.towards(behind - offset)
        if offset[2] < HEIGHT / 2:
            return self.towards(HEIGHT * UP)
        return self.towards(behind + HEIGHT * UP - offset)


class FetchPush(Push):
    """That of Fetch."""


class PandaPush(Push):
    """That of Panda, whose cube glides farther."""

    half, ahead = 0.02, 0.01

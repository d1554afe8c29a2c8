"""The quadrotor of safe-control-gym 2.0, and its LQR and MPC, as another Python plays them.

A quadrotor in a vertical plane flies to a point and stops there, from places, angles and speeds around it: goal and
distributions are those of safe-control-gym's example of stabilization (`quadrotor_2D_stab.yaml`), weights those of its
LQR and MPC. Success is `info["goal_reached"]`: the state is within 0.05 of the goal (m, m/s, rad, rad/s together).
"""

import os
from functools import partial

import gymnasium
import safe_control_gym  # noqa: F401 - registers what `make` makes
from safe_control_gym.utils.registration import make

SECONDS, FREQUENCY = 6, 50
STARTS = {
    "init_x": (-1, 1),
    "init_x_dot": (-0.1, 0.1),
    "init_z": (0.5, 1.5),
    "init_z_dot": (-0.1, 0.1),
    "init_theta": (-0.2, 0.2),
    "init_theta_dot": (-0.1, 0.1),
}
TASK = {
    "quad_type": 2,
    "ctrl_freq": FREQUENCY,
    "pyb_freq": 1000,
    "physics": "pyb",
    "gui": False,
    "task": "stabilization",
    "task_info": {
        "stabilization_goal": [0, 1],
        "stabilization_goal_tolerance": 0.05,
    },
    "episode_len_sec": SECONDS,
    "cost": "quadratic",
    "rew_state_weight": [1] * 6,
    "rew_act_weight": [0.1],
    "done_on_out_of_bound": True,
    "constraints": [
        {"constraint_form": "default_constraint", "constrained_variable": kind}
        for kind in ("state", "input")
    ],
    "randomized_init": True,
    "init_state_randomization_info": {
        name: {"distrib": "uniform", "low": low, "high": high}
        for name, (low, high) in STARTS.items()
    },
}
new_task = partial(make, "quadrotor", **TASK)
os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Ipopt prints each solution


class Quadrotor(gymnasium.Env):
    """The quadrotor, which answers as environments of Gymnasium do."""

    dt = 1 / FREQUENCY
    max_episode_steps = SECONDS * FREQUENCY

    def __init__(self):
        self.task = new_task()
        self.observation_space = self.task.observation_space
        self.action_space = self.task.action_space

    def reset(self, *, seed=None, options=None):
        """Begin an episode."""
        self.steps = 0
        return self.task.reset(seed=seed)

    def step(self, action):
        """Make a control step."""
        observation, reward, _, info = self.task.step(action)
        self.steps += 1
        is_over = self.steps >= self.max_episode_steps
        terminated = info["goal_reached"] or info["out_of_bounds"]
        return observation, reward, terminated, is_over and not terminated, info

    def close(self):
        """End the simulation."""
        self.task.close()


class LQR:
    """LQR around the goal."""

    def __init__(self):
        self.controller = make("lqr", new_task, q_lqr=[1] * 6, r_lqr=[0.1])

    def act(self, observation):
        """Return the action for an observation."""
        return self.controller.select_action(observation)


class MPC:
    """Nonlinear MPC with a horizon of 20 steps, solved by Ipopt."""

    def __init__(self):
        weights = {"q_mpc": [5, 0.1, 5, 0.1, 0.1, 0.1], "r_mpc": [0.1, 0.1]}
        self.controller = make("mpc", new_task, horizon=20, **weights)
        self.controller.reset()

    def reset(self):
        """Begin an episode."""
        self.controller.reset_before_run()

    def act(self, observation):
        """Return the action for an observation."""
        return self.controller.select_action(observation)

"""PPO in one file, in the manner of CleanRL: it trains a network for the reach task, and exports it as an agent.

Library: torch; copy this file and change it.
Autoreset: `next_step`, Gymnasium's default. After an episode has ended, the next step only resets: its action is
ignored and its reward is 0. The mask `acted` leaves these steps out of the updates.
Options: normalized actions, relative to the current joint positions; features; rewards scaled to the order of one.
`Shaped` adds the minimum time to the target, by the joints' speed limits, as a potential.

EXPECTED: 100.0% of 200 episodes after 150,000 steps, in 1 minute of one core

`python examples/one_file_ppo.py`, then `armctl compare reach_ik runs/one_file_ppo/agent.onnx`

After Schulman et al., "Proximal policy optimization algorithms" (arXiv 1707.06347), and Schulman et al.,
"High-dimensional continuous control using generalized advantage estimation" (arXiv 1506.02438).
"""

import itertools
import time
from collections import deque
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import gymnasium
import numpy as np
import torch
from rich.progress import track
from torch import nn
from torch.distributions import Independent, Normal

from armctl.agents import AgentCard, inputs, sha256, shapes
from armctl.rl.networks.onnx_graph import write_graph
from armctl.runtime.provenance import versions
from armctl.shaping import Shaped
from held_out import arguments, report

ENV = "armctl/ArmReach-v0"
ENV_OPTIONS = {
    "actions": "normalized",
    "control": "relative",
    "observation": "features",
}
SHAPING, SHAPING_SCALE = "ik", 150.0
"""Name of the potential, minus the minimum time to the target in s, and the reward per second."""
FOLDER = Path("runs/one_file_ppo")


NUM_ENVS, ROLLOUT_LENGTH = 16, 128
"""Worlds, and control steps in each between two updates."""
EPOCHS, BATCH_SIZE, LEARNING_RATE, MAX_GRADIENT_NORM = 8, 256, 5e-4, 0.5
GAMMA, GAE_LAMBDA, CLIP_RANGE = 0.99, 0.95, 0.2
HIDDEN_UNITS, INITIAL_LOG_STD, REWARD_SCALE = 128, -0.5, 0.02


class Rollout(NamedTuple):
    """Control steps (rollout_length, num_envs, ...) of all worlds."""

    observations: torch.Tensor
    actions: torch.Tensor
    log_probs: torch.Tensor
    values: torch.Tensor
    rewards: torch.Tensor
    terminated: torch.Tensor
    """1 where the episode ended, and no reward can follow."""
    ended: torch.Tensor
    """1 where the episode terminated or was truncated."""
    acted: torch.Tensor
    """0 where the step only reset the world."""


def mlp(inputs: int, outputs: int, gain: float) -> nn.Sequential:
    """Return a network with two hidden layers and orthogonal weights, as is usual for PPO."""
    layers = []
    sizes = [inputs, HIDDEN_UNITS, HIDDEN_UNITS, outputs]
    for scale, size in zip(
        [2**0.5, 2**0.5, gain], itertools.pairwise(sizes), strict=True
    ):
        layers += [nn.Linear(*size), nn.Tanh()]
        nn.init.orthogonal_(layers[-2].weight, scale)
        nn.init.zeros_(layers[-2].bias)
    return nn.Sequential(*layers[:-1])


class ActorCritic(nn.Module):
    """A Gaussian policy, whose standard deviation does not depend on the observation, and a value function."""

    def __init__(self, observation_size: int, action_size: int) -> None:
        super().__init__()
        self.actor = mlp(observation_size, action_size, gain=0.01)
        self.critic = mlp(observation_size, 1, gain=1.0)
        self.log_std = nn.Parameter(torch.full((action_size,), INITIAL_LOG_STD))

    def forward(self, *observation: torch.Tensor) -> torch.Tensor:
        """Return the mean actions (n, action_size) for the arrays (n, ...) of an observation, of which there is one."""
        return self.actor(observation[0]).clamp(-1, 1)

    def policy(self, observations: torch.Tensor) -> Independent:
        """Return the distribution of actions (..., action_size)."""
        return Independent(
            Normal(self.actor(observations), self.log_std.exp()), 1
        )

    def value(self, observations: torch.Tensor) -> torch.Tensor:
        """Return the expected discounted sums (...) of later rewards."""
        return self.critic(observations).squeeze(-1)


class Collector:
    """Plays the worlds with the current policy, and counts successes on the way."""

    def __init__(self, envs: gymnasium.vector.VectorEnv, seed: int) -> None:
        self.envs = envs
        self.observations = torch.as_tensor(envs.reset(seed=seed)[0])
        self.ended = torch.zeros(envs.num_envs)
        self.successes: deque[bool] = deque(maxlen=200)
        """Success of the last episodes, which are played with exploration noise."""

    @torch.no_grad()
    def collect(self, agent: ActorCritic) -> Rollout:
        """Make `ROLLOUT_LENGTH` control steps in every world."""
        steps = []
        for _ in range(ROLLOUT_LENGTH):
            observations, acted = self.observations, 1 - self.ended
            policy = agent.policy(observations)
            actions = policy.sample()
            observed, rewards, terminated, truncated, infos = self.envs.step(
                actions.numpy()
            )
            self.observations = torch.as_tensor(observed)
            self.ended = torch.as_tensor(terminated | truncated).float()
            self.successes.extend(infos["is_success"][terminated | truncated])
            decision = (
                observations,
                actions,
                policy.log_prob(actions),
                agent.value(observations),
            )
            outcome = (
                torch.as_tensor(rewards).float(),
                torch.as_tensor(terminated).float(),
                self.ended,
            )
            steps.append((*decision, *outcome, acted))
        return Rollout(*map(torch.stack, zip(*steps, strict=True)))


def advantages_of(rollout: Rollout, last_values: torch.Tensor) -> torch.Tensor:
    """Return generalized advantage estimates (rollout_length, num_envs).

        delta_t = r_t + gamma V(s_t+1) (1 - terminated_t) - V(s_t)
        A_t     = delta_t + gamma lambda (1 - ended_t) A_t+1

    After a truncated episode, V(s_t+1) is the value of its last observation, which the step that only resets observes.
    """
    next_values = torch.cat([rollout.values[1:], last_values[None]])
    deltas = (
        rollout.rewards
        + GAMMA * next_values * (1 - rollout.terminated)
        - rollout.values
    )
    decay = GAMMA * GAE_LAMBDA * (1 - rollout.ended)
    advantages = torch.zeros_like(deltas)
    advantage = torch.zeros_like(last_values)
    for t in reversed(range(len(deltas))):
        advantages[t] = advantage = deltas[t] + decay[t] * advantage
    return advantages


def update(
    agent: ActorCritic,
    optimizer: torch.optim.Optimizer,
    rollout: Rollout,
    advantages: torch.Tensor,
) -> int:
    """Improve policy and value by clipped gradient steps; return how many."""
    acted = rollout.acted > 0
    returns = (advantages + rollout.values)[acted]
    advantages = advantages[acted]
    observations, actions, log_probs, *_ = (part[acted] for part in rollout)
    batches = [
        batch
        for _ in range(EPOCHS)
        for batch in torch.randperm(len(returns)).split(BATCH_SIZE)
    ]
    for batch in batches:
        advantage = advantages[batch]
        advantage = (advantage - advantage.mean()) / (
            advantage.std(correction=0) + 1e-8
        )
        ratio = (
            agent.policy(observations[batch]).log_prob(actions[batch])
            - log_probs[batch]
        ).exp()
        clipped = ratio.clamp(1 - CLIP_RANGE, 1 + CLIP_RANGE)
        policy_loss = -torch.min(ratio * advantage, clipped * advantage).mean()
        value_loss = (
            agent.value(observations[batch]) - returns[batch]
        ).square().mean() / 2
        optimizer.zero_grad()
        (policy_loss + value_loss).backward()
        nn.utils.clip_grad_norm_(agent.parameters(), MAX_GRADIENT_NORM)
        optimizer.step()
    return len(batches)


def train(
    envs: gymnasium.vector.VectorEnv, steps: int, seed: int
) -> tuple[ActorCritic, dict[str, int]]:
    """Train for at least `steps` control steps, and return the networks, and what the training took."""
    torch.manual_seed(seed)
    spaces = envs.single_observation_space, envs.single_action_space
    agent = ActorCritic(*(space.shape[0] for space in spaces))
    optimizer = torch.optim.Adam(agent.parameters(), lr=LEARNING_RATE)
    collector, gradient_steps = Collector(envs, seed), 0
    steps_per_update = NUM_ENVS * ROLLOUT_LENGTH
    updates = -(-steps // steps_per_update)
    for number in track(range(1, updates + 1), "training"):
        rollout = collector.collect(agent)
        with torch.no_grad():
            last_values = agent.value(collector.observations)
        gradient_steps += update(
            agent, optimizer, rollout, advantages_of(rollout, last_values)
        )
        if number % 10 == 0 or number == updates:
            success = np.mean(collector.successes or [0.0])
            steps_so_far = number * steps_per_update
            print(
                f"{steps_so_far:9,} steps: {success:.0%} with exploration noise"
            )
    return agent, {
        "training_steps": updates * steps_per_update,
        "gradient_steps": gradient_steps,
    }


def export(
    agent: ActorCritic, envs: gymnasium.vector.VectorEnv, **training: object
) -> Path:
    """Write the graph of the mean action, and its card, which armctl plays.

    Return the card's path. `training` has its fields about the training.
    """
    FOLDER.mkdir(parents=True, exist_ok=True)
    graph, card_file = FOLDER / "agent.onnx", FOLDER / "agent.json"
    space = envs.single_observation_space
    write_graph(agent, inputs(space), {}, graph)
    card = AgentCard(
        name=FOLDER.name,
        learner="one_file_ppo",
        env=ENV,
        env_options=ENV_OPTIONS,
        shaping=SHAPING,
        shaping_scale=SHAPING_SCALE,
        lineage=[],
        interface=envs.unwrapped.task.interface,
        observation_shape=shapes(space),
        action_shape=list(envs.single_action_space.shape),
        versions=versions()
        | {package: version(package) for package in ("torch", "onnx")},
        sha256=sha256(graph),
        **training,
    )
    card_file.write_text(card.model_dump_json(indent=2) + "\n")
    return card_file


def main() -> None:
    """Train, export, and count successes on held-out episodes."""
    given, start = arguments(__doc__, steps=150_000), time.monotonic()
    envs = gymnasium.make_vec(
        f"armctl:{ENV}",
        NUM_ENVS,
        autoreset_mode="next_step",
        reward_scale=REWARD_SCALE,
        **ENV_OPTIONS,
    )
    envs = Shaped(envs, SHAPING, gamma=GAMMA, scale=SHAPING_SCALE)
    agent, costs = train(envs, given.steps, seed=given.seed)
    card_file = export(
        agent,
        envs,
        **costs,
        decisions=costs["training_steps"],
        processor_seconds=time.process_time(),
        training_minutes=(time.monotonic() - start) / 60,
        training_seed=given.seed,
        learner_options={
            "epochs": EPOCHS,
            "learning_rate": LEARNING_RATE,
            "gamma": GAMMA,
            "hidden_units": HIDDEN_UNITS,
        },
    )
    envs.close()
    print(f"agent: {card_file}")
    report(card_file, ENV, given.episodes, **ENV_OPTIONS)


if __name__ == "__main__":
    main()

"""PPO in one file, in the manner of CleanRL, with nothing but torch, on 16 worlds of the reach task.

Library: torch; copy this file and change it.
Autoreset: `next_step`, Gymnasium's default. After an episode has ended, the next step only resets: its action is
ignored and its reward is 0. Here, `real` marks the steps that are to be learned from.
Options: normalized actions, relative to where the joints are; features; rewards scaled to the order of one. `Shaped`
adds what the IK expert knows of the time to the target.

EXPECTED: 100.0% of 200 episodes after 150,000 steps, in 2 minutes of one core

`python examples/cleanrl_ppo.py`
"""

import gymnasium
import torch
from held_out import arguments, report
from torch import nn
from torch.distributions import Normal

from armctl.shaping import Shaped

ID = "armctl:armctl/ArmReach-v0"
OPTIONS = {"actions": "normalized", "control": "relative", "observation": "features"}
WORLDS, ROLLOUT, GAMMA, LAMBDA = 16, 128, 0.99, 0.95


def layer(inputs, outputs, gain=2**0.5):
    """A linear layer, orthogonal at first, as is usual for PPO."""
    made = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(made.weight, gain)
    nn.init.zeros_(made.bias)
    return made


def network(inputs, outputs, gain):
    """Two hidden layers."""
    return nn.Sequential(layer(inputs, 128), nn.Tanh(), layer(128, 128), nn.Tanh(), layer(128, outputs, gain))


given = arguments(__doc__, steps=150_000)
torch.manual_seed(given.seed)
worlds = gymnasium.make_vec(ID, num_envs=WORLDS, autoreset_mode="next_step", reward_scale=0.02, **OPTIONS)
worlds = Shaped(worlds, "ik", gamma=GAMMA, scale=150)  # per second nearer to the target
seen_size, acted_size = worlds.single_observation_space.shape[0], worlds.single_action_space.shape[0]
actor, critic = network(seen_size, acted_size, gain=0.01), network(seen_size, 1, gain=1)
log_std = nn.Parameter(-torch.ones(acted_size) / 2)
parameters = [*actor.parameters(), *critic.parameters(), log_std]
optimizer = torch.optim.Adam(parameters, lr=5e-4)

observation, ended = torch.tensor(worlds.reset(seed=given.seed)[0]), torch.zeros(WORLDS)
for _ in range(-(-given.steps // (WORLDS * ROLLOUT))):
    rollout = []
    for _ in range(ROLLOUT):
        with torch.no_grad():
            chosen = Normal(actor(observation), log_std.exp())
            action, value = chosen.sample(), critic(observation).squeeze(-1)
        now, real = observation, 1 - ended
        observation, *what = (torch.as_tensor(part) for part in worlds.step(action.numpy())[:4])
        reward, terminated, truncated = (part.float() for part in what)
        ended = terminated + truncated
        rollout.append((now, action, chosen.log_prob(action).sum(-1), value, reward, terminated, ended, real))
    seen, acted, log_probs, values, rewards, terminals, ends, real = map(torch.stack, zip(*rollout, strict=True))
    with torch.no_grad():
        following = torch.cat([values[1:], critic(observation).T])
    advantages, running = torch.zeros_like(values), torch.zeros(WORLDS)
    for t in reversed(range(ROLLOUT)):
        error = rewards[t] + GAMMA * following[t] * (1 - terminals[t]) - values[t]
        running = error + GAMMA * LAMBDA * (1 - ends[t]) * running
        advantages[t] = running
    learnt = [part[real > 0] for part in (seen, acted, log_probs, advantages, advantages + values)]
    for _ in range(8):
        for index in torch.randperm(len(learnt[0])).split(256):
            seen, acted, before, gained, returned = (part[index] for part in learnt)
            ratio = (Normal(actor(seen), log_std.exp()).log_prob(acted).sum(-1) - before).exp()
            gained = (gained - gained.mean()) / (gained.std(correction=0) + 1e-8)
            gain = torch.min(ratio * gained, ratio.clamp(0.8, 1.2) * gained).mean()
            loss = (critic(seen).squeeze(-1) - returned).square().mean() / 2 - gain
            optimizer.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(parameters, 0.5)
            optimizer.step()


def policy(observation):
    """The mean action."""
    with torch.no_grad():
        return actor(torch.as_tensor(observation)).numpy()


report(policy, ID, given.episodes, **OPTIONS)

"""PPO of TorchRL on 16 worlds of the reach task that are stepped at once.

Library: torchrl, by `GymWrapper`.
Autoreset: `disabled`, which TorchRL prefers: it resets worlds itself. `same_step` works too, with `flat_infos=True`.
Options: normalized actions, relative to the current joint positions; features; rewards scaled to the order of one.
`Shaped` adds the minimum time to the target, by the joints' speed limits, as a potential.

EXPECTED: 100.0% of 200 episodes after 300,000 steps, in 5 minutes of one core

`python examples/torchrl_ppo.py`
"""

import gymnasium
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from tensordict.nn.distributions import NormalParamExtractor
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs import ExplorationType, GymWrapper, set_exploration_type
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from armctl.shaping import Shaped
from held_out import arguments, report

ID = "armctl:armctl/ArmReach-v0"
OPTIONS = {
    "actions": "normalized",
    "control": "relative",
    "observation": "features",
}
WORLDS, ROLLOUT, GAMMA = 16, 128, 0.99


def layer(inputs, outputs, gain=2**0.5):
    """A linear layer, orthogonal at first, as is usual for PPO."""
    made = nn.Linear(inputs, outputs)
    nn.init.orthogonal_(made.weight, gain)
    nn.init.zeros_(made.bias)
    return made


def network(inputs, outputs, gain):
    """Two hidden layers."""
    return nn.Sequential(
        layer(inputs, 128),
        nn.Tanh(),
        layer(128, 128),
        nn.Tanh(),
        layer(128, outputs, gain),
    )


given = arguments(__doc__, steps=300_000)
torch.manual_seed(given.seed)
worlds = gymnasium.make_vec(
    ID, num_envs=WORLDS, autoreset_mode="disabled", reward_scale=0.02, **OPTIONS
)
env = GymWrapper(
    Shaped(worlds, "ik", gamma=GAMMA, scale=150)
)  # per second nearer to the target
env.set_seed(given.seed, static_seed=True)
seen_size, acted_size = (
    worlds.single_observation_space.shape[0],
    worlds.single_action_space.shape[0],
)
parameters = nn.Sequential(
    network(seen_size, 2 * acted_size, gain=0.01),
    NormalParamExtractor("biased_softplus_0.6"),
)
actor = ProbabilisticActor(
    TensorDictModule(
        parameters, in_keys=["observation"], out_keys=["loc", "scale"]
    ),
    in_keys=["loc", "scale"],
    spec=env.action_spec_unbatched,
    distribution_class=TanhNormal,
    return_log_prob=True,
)
critic = ValueOperator(network(seen_size, 1, gain=1), in_keys=["observation"])
loss = ClipPPOLoss(actor, critic, entropy_bonus=False, critic_coeff=0.5)
advantage = GAE(gamma=GAMMA, lmbda=0.95, value_network=critic)
optimizer = torch.optim.Adam(loss.parameters(), lr=5e-4)
rollout = WORLDS * ROLLOUT
total = -(-given.steps // rollout) * rollout
for data in Collector(
    env,
    actor,
    frames_per_batch=rollout,
    total_frames=total,
    auto_register_policy_transforms=True,
):
    with torch.no_grad():
        advantage(data)
    for _ in range(8):
        for index in torch.randperm(data.numel()).split(256):
            losses = loss(data.reshape(-1)[index])
            optimizer.zero_grad()
            (losses["loss_objective"] + losses["loss_critic"]).backward()
            nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
            optimizer.step()


def policy(observation):
    """The mean action."""
    with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        return actor(TensorDict({"observation": torch.as_tensor(observation)}))[
            "action"
        ].numpy()


report(policy, ID, given.episodes, **OPTIONS)

"""PPO whose agent is the average of its policy over the last updates (Polyak and Juditsky, 1992).

From one update to the next, the success of a policy goes up and down; that of an average of their weights much less.
"""

import copy

import torch
from stable_baselines3 import PPO


class AveragedPpo(PPO):
    """PPO that keeps `average`, an exponential moving average of its policy's weights.

    Each update of the policy leaves the share `averaging` of the average as it is. With 0, it is the policy itself.
    """

    averaging = 0.0

    def _setup_model(self) -> None:
        super()._setup_model()
        self.average = copy.deepcopy(self.policy).requires_grad_(False)

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), "average", "averaging"]

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        modules, tensors = super()._get_torch_save_params()
        return [*modules, "average"], tensors

    def train(self) -> None:
        """Update policy and average by the rollouts."""
        super().train()
        self.renew_average()

    def renew_average(self) -> None:
        """Move the average towards the policy."""
        with torch.no_grad():
            for kept, new in zip(self.average.parameters(), self.policy.parameters(), strict=True):
                kept.lerp_(new, 1 - self.averaging)

"""Trains the networks that foresee moving targets: `python tools/train_forecasts.py`.

Each reads windows of curves of the task's distribution (`armctl.tasks.reach.moving`), of other sizes too, with white
noise of a size of their own, and with readings that are missing. No environment is needed. `--seed 0` trains one.
"""

import functools
import json
import math
import time
from pathlib import Path
from typing import Annotated

import gymnasium
import numpy as np
import torch
import typer

from armctl.agents.agent import sha256
from armctl.baselines.hybrids.target_forecast import FOLDER, KNOTS, READ, SEEDS, VELOCITY, WINDOW
from armctl.core.files import write_atomically
from armctl.rl.networks.onnx_graph import write_graph
from armctl.tasks.reach import CONTROL_PERIOD
from armctl.tasks.reach.moving import RATES, WAVES, ReachMovingOptions

BATCH, HIDDEN, LEARNING_RATE = 1024, 128, 2e-3
SIZES = 0.3, 1.7
"""Factors of the task's amplitude."""
NOISE = 0.0005, 0.1
"""m and m/s: range of standard deviations, whose logarithms are uniform."""
NOISELESS, BEGINNING, GAPPED, GAPS = 0.15, 0.4, 0.15, 0.15
"""Shares of windows: without noise, of an episode that has just begun, with gaps; and of the readings lost in these."""
UNITS = torch.tensor([[[0.1], [0.25]]])
"""m and m/s."""
WEIGHTS = torch.tensor([[[1.0], [0.3]]])
"""Weights of errors of position and velocity in the loss, 1/m and s/m."""


class ForecastNetwork(torch.nn.Module):
    """Windows (n, 3, k) to positions and velocities (n, 2, knots): a linear filter and a correction of it."""

    def __init__(self) -> None:
        super().__init__()
        size, outputs = 3 * WINDOW, 2 * len(KNOTS)
        self.linear = torch.nn.Linear(size, outputs)
        layers = torch.nn.Linear(size, HIDDEN), torch.nn.ReLU(), torch.nn.Linear(HIDDEN, HIDDEN), torch.nn.ReLU()
        self.correction = torch.nn.Sequential(*layers, torch.nn.Linear(HIDDEN, outputs))
        torch.nn.init.zeros_(self.correction[-1].weight)
        torch.nn.init.zeros_(self.correction[-1].bias)
        self.register_buffer("units", UNITS)
        self.register_buffer("scale", torch.tensor([10.0, 4.0, 1.0])[:, None])

    def forward(self, *windows: torch.Tensor) -> torch.Tensor:
        """Return positions (m) and velocities (m/s) at the knots, for the one array that there is."""
        inputs = (windows[0] * self.scale).flatten(1)
        return self.units * (self.linear(inputs) + self.correction(inputs)).unflatten(1, (2, len(KNOTS)))


def examples(n: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Draw windows (n, 3, k) and what the network should return for them."""
    times = torch.cat((torch.arange(1 - WINDOW, 1) * CONTROL_PERIOD, torch.as_tensor(KNOTS, dtype=torch.float32)))
    uniform = functools.partial(torch.rand, n, WAVES, 1)
    amplitudes = ReachMovingOptions().amplitude * (0.5 + 0.5 * uniform()) / torch.arange(1, WAVES + 1)[:, None]
    amplitudes *= SIZES[0] + (SIZES[1] - SIZES[0]) * torch.rand(n, 1, 1)
    rates, phases = RATES[0] + (RATES[1] - RATES[0]) * uniform(), 2 * math.pi * uniform()
    angles = rates * times + phases
    curves = torch.stack(((amplitudes * angles.sin()).sum(1), (amplitudes * rates * angles.cos()).sum(1)), 1)
    noise = NOISE[0] * (NOISE[1] / NOISE[0]) ** torch.rand(n, 1, 1) * (torch.rand(n, 1, 1) > NOISELESS)
    readings = curves[:, :, :WINDOW] + noise * torch.randn(n, 2, WINDOW)
    first = WINDOW * torch.rand(n, 1) * (torch.rand(n, 1) < BEGINNING)
    has_read = (torch.arange(WINDOW) >= first.floor()) & ((torch.rand(n, WINDOW) > GAPS) | (torch.rand(n, 1) > GAPPED))
    has_read[:, -1] = True
    mask = has_read[:, None].float()
    mean = (readings[:, :VELOCITY] * mean_weights(mask)).sum(2, keepdim=True)
    offsets = torch.cat((mean, torch.zeros_like(mean)), 1)
    windows = torch.cat(((readings - offsets) * mask, mask), 1)
    assert windows.shape[1] == READ + 1
    return windows, curves[:, :, WINDOW:] - offsets


def mean_weights(mask: torch.Tensor) -> torch.Tensor:
    """Return weights that sum up to 1 over the readings."""
    return mask / mask.sum(2, keepdim=True)


def train(seed: int, updates: int, folder: Path) -> None:
    """Train a network; write its graph, and a card with its costs."""
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    clocks = time.monotonic(), time.process_time()
    network = ForecastNetwork()
    optimizer = torch.optim.Adam(network.parameters(), LEARNING_RATE)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, LEARNING_RATE, updates, pct_start=0.05)
    for update in range(updates):
        windows, targets = examples(BATCH)
        loss = ((network(windows) - targets).abs() * WEIGHTS).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if update % 1000 == 999:
            print(f"seed {seed}, {update + 1} updates: loss {loss.item():.5f}", flush=True)
    wall, processor = time.monotonic() - clocks[0], time.process_time() - clocks[1]
    space = gymnasium.spaces.Box(-1.0, 1.0, (3, WINDOW), np.float32)
    graph = folder / f"target-{seed}.onnx"
    write_graph(network, {"observation": space}, {}, graph)
    cost = {
        "steps": updates * BATCH, "minutes": round(wall / 60, 2), "decisions": 0, "teacher_queries": 0,
        "gradient_steps": updates, "processor_seconds": round(processor, 1),
    }  # fmt: skip
    card = {"seed": seed, "sha256": sha256(graph), "cost": cost}
    write_atomically(graph.with_suffix(".json"), json.dumps(card, indent=2) + "\n")


def main(
    seed: Annotated[list[int] | None, typer.Option(help="Training seeds; by default all that are shipped.")] = None,
    updates: Annotated[int, typer.Option(min=100)] = 4_000,
    out: Path = FOLDER,
) -> None:
    """Train the networks."""
    for each in seed or SEEDS:
        train(each, updates, out)


if __name__ == "__main__":
    typer.run(main)

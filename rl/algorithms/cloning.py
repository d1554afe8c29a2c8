"""Shared by learners from demonstrations: the examples, the network, and fitting the network to the examples."""

from collections.abc import Callable, Iterator
from typing import Any, Protocol

import numpy as np
import torch
from tqdm import tqdm

from armctl.agents import AgentCard
from armctl.rl.networks.actor import Actor, tensors
from armctl.rl.networks.gains import GainNetwork
from armctl.rl.networks.layers import hidden_layers
from armctl.rl.run.disk import torch_bytes
from armctl.rl.run.options import TrainingOptions
from armctl.rl.run.training import Training

LAST_RATE = 0.02
"""Share of the learning rate that remains at the end of a fit."""


def new_actor(training: Training, options: TrainingOptions, gains: bool = False, kind: type[Actor] = Actor) -> Actor:
    """Make an untrained actor, whose network gives actions, or `gains` on errors (see `GainNetwork`)."""
    torch.manual_seed(training.seed)
    view, space = training.view, training.held_out.single_observation_space
    features = view.extractor(space)
    hidden, actions = [options.hidden_units] * options.layers, training.held_out.single_action_space.shape[0]
    if gains:
        return kind(GainNetwork(features, hidden, actions), view.action_scale, space)
    sizes = [features.features_dim, *hidden]
    network = torch.nn.Sequential(features, *hidden_layers(sizes), torch.nn.Linear(sizes[-1], actions))
    return kind(network, view.action_scale, space)


class Samples(Protocol):
    """Examples to draw from."""

    def draw(self, rng: np.random.Generator, size: int) -> tuple[Any, torch.Tensor]:
        """Return a random batch of observations and actions (size, ...)."""


def fit_and_export(
    training: Training,
    actor: Actor,
    examples: Samples,
    batch_size: int,
    renew: Callable[[int], None] | None = None,
) -> AgentCard:
    """Fit an actor to the examples from the newest checkpoint on, evaluate it now and then, and export the best.

    `renew` is called with the number of gradient steps that have been taken, at the start and after each.
    """
    options, step = training.options, 0
    if (newest := training.newest_checkpoint()) is not None:
        actor.load_state_dict(torch.load(newest, weights_only=True))
        step = int(newest.stem)
    fitting = fit(
        training, actor, examples, options.steps, np.random.default_rng((training.seed, step)),
        batch_size=batch_size, learning_rate=options.learning_rate, start=step,
    )  # fmt: skip

    def save() -> None:
        training.checkpoint(step, torch_bytes(actor.state_dict()))

    try:
        if renew:
            renew(step)
        for step in fitting:
            if renew:
                renew(step)
            if step % options.evaluation_every == 0:
                save()
                training.evaluate(actor, step)
    finally:
        if step:
            save()
    return training.finish(actor, step)


def fit(
    training: Training,
    actor: Actor,
    examples: Samples,
    steps: int,
    rng: np.random.Generator,
    *,
    batch_size: int,
    learning_rate: float,
    start: int = 0,
) -> Iterator[int]:
    """Fit the actor by its loss.

    Yields the number of each gradient step, from `start` + 1 to `steps`. The learning rate decays linearly.
    """
    optimizer = torch.optim.Adam(actor.parameters(), learning_rate)
    training.meter.watch(optimizer)
    for step in tqdm(range(start, steps), "fit", leave=False, disable=not training.shows_bars):
        for group in optimizer.param_groups:
            group["lr"] = learning_rate * max(1 - step / steps, LAST_RATE)
        observations, actions = map(tensors, examples.draw(rng, batch_size))
        loss = actor.loss(observations, actions)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        yield step + 1

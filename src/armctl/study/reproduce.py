"""Checks whether a learned agent performs as its card says."""

import hashlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import scipy

from armctl.agents import AgentCard, Evaluation, read_card
from armctl.core.errors import AgentFileError, ConfigurationError
from armctl.core.registration import remember_named
from armctl.core.seeds import Seed, evaluation_seed
from armctl.envs import check_from_file, full_id
from armctl.policies.trainings import card_path
from armctl.rollout.loop import evaluate
from armctl.rollout.seeding import check_seed
from armctl.stats.correction import holm
from armctl.stats.intervals import success_rate
from armctl.stats.unpaired import unconditional

FIGURES = {
    "success_rate": "success", "success_interval": "the interval of success", "mean_return": "return",
    "mean_steps_to_goal": "steps to the goal", "mean_steps": "steps", "std_return": "deviation of the return",
    "std_steps": "deviation of the steps", "digest": "outcomes and lengths of episodes",
}  # fmt: skip
"""The figures of an evaluation, in words."""
SIGNIFICANT = 0.05


@dataclass(frozen=True)
class Difference:
    """A figure on a card that is not what was measured."""

    figure: str
    """One of `FIGURES`."""
    claimed: Any
    measured: Any
    p: float | None = None
    """p-value of a test between other episodes, after Holm's correction for all figures; None for the same episodes."""

    def __str__(self) -> str:
        name = FIGURES[self.figure]
        if self.figure == "digest":
            return f"{name} differ"
        if isinstance(self.claimed, float) and isinstance(self.measured, float):
            size = f"{name} {self.claimed:g} on the card, {self.measured:g} now ({self.measured - self.claimed:+.3g})"
            return size if self.p is None else f"{size}, p = {self.p:.2g}"
        return f"{name} {_text(self.claimed)} on the card, {_text(self.measured)} now"


@dataclass(frozen=True)
class Reproduction:
    """An agent's evaluation on its card, and a new one."""

    card: AgentCard
    claimed: Evaluation
    """The evaluation on the card."""
    measured: Evaluation
    """The new one, on the same episodes, or on as many of another seed."""
    obeys_seed: bool = True
    """True if the environment plays the same episodes again."""

    @property
    def same_episodes(self) -> bool:
        """True if both are of the same episodes."""
        claimed, measured = self.claimed, self.measured
        return self.obeys_seed and (claimed.seed, claimed.episodes) == (measured.seed, measured.episodes)

    @property
    def differences(self) -> list[Difference]:
        """The figures that are not those of one agent.

        On the same episodes, all that is on the card has to be equal. On other episodes, success, return and steps have
        to pass a two-sample test each, which together refuse an honest card in about 1 of 20 cases.
        """
        return _unequal(self.claimed, self.measured) if self.same_episodes else _told_apart(self.claimed, self.measured)

    @property
    def agrees(self) -> bool:
        """True if no figure differs."""
        return not self.differences


def _unequal(claimed: Evaluation, measured: Evaluation) -> list[Difference]:
    pairs = ((name, getattr(claimed, name), getattr(measured, name)) for name in FIGURES)
    return [Difference(name, a, b) for name, a, b in pairs if not _equal(name, a, b)]


def _equal(name: str, claimed: Any, measured: Any) -> bool:
    """Return True if a figure is the same; one that an older card lacks claims nothing."""
    if name == "success_interval":  # computed from the rate, and the last digit depends on SciPy's version
        return bool(np.allclose(claimed, measured, rtol=1e-9, atol=1e-12))
    return claimed == measured or (claimed is None and name != "mean_steps_to_goal")


def _told_apart(claimed: Evaluation, measured: Evaluation) -> list[Difference]:
    """Barnard's exact test of successes, and Welch's of returns and steps if the card has their deviations."""
    counts = [(round(of.episodes * of.success_rate), of.episodes) for of in (claimed, measured)]
    p_values = {"success_rate": unconditional(*counts[0], *counts[1])}
    for mean, std in (("mean_return", "std_return"), ("mean_steps", "std_steps")):
        numbers = [(getattr(of, mean), getattr(of, std), of.episodes) for of in (claimed, measured)]
        if all(None not in values and values[2] > 1 for values in numbers):
            p_values[mean] = _welch(*numbers)
    corrected = dict(zip(p_values, holm(list(p_values.values())), strict=True))
    return [
        Difference(name, getattr(claimed, name), getattr(measured, name), p)
        for name, p in corrected.items()
        if p < SIGNIFICANT
    ]


def _welch(a: tuple[float, float, int], b: tuple[float, float, int]) -> float:
    """Return the p-value of Welch's test between two means, each with its deviation and number of episodes."""
    if a[1] == b[1] == 0.0:
        return float(math.isclose(a[0], b[0], rel_tol=1e-9))
    return float(scipy.stats.ttest_ind_from_stats(*a, *b, equal_var=False).pvalue)


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(f'{number:g}' for number in value)}]"
    return "unknown" if value is None else f"{value:g}"


def reproduce(agent: str | Path, *, seed: Seed | None = None, worlds: int = 64, env: str | None = None) -> Reproduction:
    """Evaluate an agent again, on the episodes named by its card or on those of another seed, `"test"` too.

    `agent` is the path of its card or graph, or the name of an installed one. A card runs no code: if its environment
    is `module:name`, that has to be given as `env`, or was named in this process before.

    Raises `AgentFileError` for unusable files and cards without an evaluation, and `ConfigurationError` for an unknown
    name or one without a card.
    """
    path = card_path(agent)
    card = read_card(path)
    if (claimed := card.evaluation) is None:
        raise AgentFileError(f"the card {path} has no evaluation to reproduce")
    if env is not None:
        if full_id(env) != card.env:
            raise ConfigurationError(f"{path} is of an agent for {card.env}, not for {env}")
        remember_named(card.env)
    check_from_file(card.env, card.env_options, str(path))
    seed = evaluation_seed(claimed.seed if seed is None else seed)
    episodes = evaluate(
        path,
        card.env,
        episodes=claimed.episodes,
        seed=seed,
        worlds=worlds,
        env_options=card.env_options,
        lower_bound_steps=False,
    )
    obeys_seed = check_seed(card.env, card.env_options).obeyed
    return Reproduction(card, claimed, evaluation_of(episodes, seed), obeys_seed)


def evaluation_of(episodes: pd.DataFrame, seed: int) -> Evaluation:
    """Return the figures on a card, from episodes (rows of `armctl.evaluate`) of one seed."""
    rate = success_rate(episodes.success.to_numpy(bool))
    assert rate is not None
    steps = episodes.length[episodes.success]
    ends = [f"{outcome} {length}" for outcome, length in zip(episodes.outcome, episodes.length, strict=True)]
    return Evaluation(
        episodes=len(episodes),
        seed=seed,
        success_rate=rate.value,
        success_interval=rate.bounds,
        mean_return=float(episodes["return"].mean()),
        mean_steps_to_goal=float(steps.mean()) if len(steps) else None,
        mean_steps=float(episodes.length.mean()),
        std_return=_deviation(episodes["return"]),
        std_steps=_deviation(episodes.length),
        digest=hashlib.sha256("\n".join(ends).encode()).hexdigest(),
    )


def _deviation(values: pd.Series) -> float | None:
    return float(values.std()) if len(values) > 1 else None

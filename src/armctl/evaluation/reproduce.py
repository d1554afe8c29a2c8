"""Checks whether a learned agent performs as its card says."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats

from armctl.agents import AgentCard, Evaluation, read_card
from armctl.envs import check_from_file, full_id
from armctl.errors import AgentFileError, ConfigurationError, unknown_name
from armctl.evaluation.rollouts import evaluate
from armctl.evaluation.statistics import success_rate
from armctl.policies import GROUP, agent_cards, training_card
from armctl.registration import installed, remember_named


@dataclass(frozen=True)
class Reproduction:
    """An agent's evaluation on its card, and a new one."""

    card: AgentCard
    claimed: Evaluation
    """The evaluation on the card."""
    found: Evaluation
    """The new one, on the same episodes, or on as many of another seed."""

    @property
    def agrees(self) -> bool:
        """Whether both success rates may be those of one agent: Fisher's exact test, wrong in at most 1 of 20 cases."""
        played = np.array([one.episodes for one in (self.claimed, self.found)])
        won = np.round(played * [one.success_rate for one in (self.claimed, self.found)]).astype(int)
        return bool(stats.fisher_exact(np.column_stack((won, played - won))).pvalue >= 0.05)


def reproduce(agent: str | Path, *, seed: int | None = None, worlds: int = 64, env: str | None = None) -> Reproduction:
    """Evaluate an agent again, on the episodes named by its card or on those of another seed.

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
    seed = claimed.seed if seed is None else seed
    episodes = evaluate(
        path,
        card.env,
        episodes=claimed.episodes,
        seed=seed,
        worlds=worlds,
        env_options=card.env_options,
        least_lengths=False,
    )
    return Reproduction(card, claimed, evaluation_of(episodes, seed))


def card_path(agent: str | Path) -> Path:
    """The path of an agent's card: of its card or graph, of an installed agent's name, or of `NAME[SEED]`."""
    path = Path(agent)
    if path.suffix in (".json", ".onnx"):
        return path.with_suffix(".json")
    if (card := training_card(str(agent))) is not None:
        return card
    cards = agent_cards()
    if str(agent) in installed(GROUP).names - cards.keys():
        raise ConfigurationError(
            f"{agent} is not a learned agent: it has no card, and so nothing to reproduce. Agents are "
            f"{', '.join(sorted(cards))}, or path/to/agent.json; armctl compare plays any policy"
        )
    if str(agent) not in cards:
        raise unknown_name("agent", agent, [*cards, "path/to/agent.json"])
    return cards[str(agent)]


def evaluation_of(episodes: pd.DataFrame, seed: int) -> Evaluation:
    """The figures on a card, from episodes (rows of `armctl.evaluate`) of one seed."""
    rate = success_rate(episodes.success.to_numpy(bool))
    assert rate is not None
    steps = episodes.length[episodes.success]
    return Evaluation(
        episodes=len(episodes),
        seed=seed,
        success_rate=rate.value,
        success_interval=rate.bounds,
        mean_return=float(episodes["return"].mean()),
        mean_steps_to_goal=float(steps.mean()) if len(steps) else None,
    )

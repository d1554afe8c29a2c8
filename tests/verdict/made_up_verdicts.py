"""Summaries and pairs of policies that won so many episodes, as verdicts are made of."""

import dataclasses
import itertools

import numpy as np

from armctl.agents.costs import TrainingCost
from armctl.stats.difference import Scores, difference_between
from armctl.stats.intervals import success_rate
from armctl.verdict.sentences import verdict
from armctl.verdict.summary import PolicySummary

AGENTS = ("reach_ppo", "reach_sac", "reach_bc", "reach_dagger", "moving_ppo")


TRAINED = dict.fromkeys(AGENTS, 1_500_000) | {"mine.json": 20_000}


def cost_of(name):
    return TrainingCost(TRAINED[name], 12.0, TRAINED[name], 0, 940_321) if name in TRAINED else TrainingCost()


def summary_of(name, won):
    values = {field.name: None for field in dataclasses.fields(PolicySummary)}
    known = {
        "policy": name, "sees": "observation" if name in TRAINED else "model", "training": cost_of(name),
        "planned": len(won), "episodes": len(won),
        "spared": (), "foresight": (), "interface": {}, "outcomes": {},
        "success": success_rate(won), "decision_ms_p50": 0.25, "decision_ms_p99": 0.5,
        "worlds": 1, "workers": 1,
    }  # fmt: skip
    return PolicySummary(**values | known)


def said(wins, episodes=400, **options):
    """The verdict on policies that won the episodes whose numbers are in `wins`."""
    return text_of(*played(wins, episodes), **options)


def text_of(*args, **options):
    """The whole verdict as a text."""
    return str(verdict(*args, **options))


LIMIT = 100


def played(wins, episodes=400, steps=None, returns=None, paired=True):
    """Summaries and pairs of policies that won these episodes, in so many steps (their numbers, or those of each)."""
    won = {name: np.isin(np.arange(episodes), list(numbers)) for name, numbers in wins.items()}
    return compared(won, steps, returns, paired)


def compared(won, steps=None, returns=None, paired=True):
    earned = returns or {name: of * 1.0 for name, of in won.items()}
    late = steps and {name: np.where(of, steps[name], LIMIT) for name, of in won.items()}
    couples = list(itertools.combinations(won, 2))
    num = len(couples)
    pairs = [
        difference_between(
            a,
            b,
            Scores((won[a], won[b]), (earned[a], earned[b]), (late[a], late[b]) if late else None, (0, 1), LIMIT),
            num,
            paired=paired,
        )
        for a, b in couples
    ]
    return [summary_of(name, of) for name, of in won.items()], pairs

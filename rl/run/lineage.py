"""Lineage of a training: the networks and experts that it learned from, and the trials that found its recipe."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from armctl.agents import AgentCard, Ancestor, distinct, read_card
from armctl.agents.costs import UNTRAINED, TrainingCost, TuningCost, total_tuning
from armctl.datasets.minari import policy_of
from armctl.envs import EpisodeVectorEnv
from armctl.policies import make_policy, policy_names
from armctl.policies.trainings import card_of
from armctl.rl.agents import AGENTS
from armctl.training.learners import Recipe
from armctl.training.trials import TRIALS, read_trials


def lineage_of(recipe: Recipe, options: Any, envs: EpisodeVectorEnv) -> list[Ancestor]:
    """Return all networks and experts that a training learns from, each once.

    It learns from its teacher, or a dataset's policy, and from the agent from whose weights it starts. `envs` are of
    the recipe's environment. Raises `ConfigurationError` for a teacher that cannot be made there.
    """
    dataset, start = getattr(options, "dataset", None), getattr(options, "start", None)
    teacher = recipe.teacher if dataset is None else policy_of(dataset)
    policies = [policy for policy in (teacher, start) if policy is not None]
    return distinct([line for policy in policies for line in _line_of(policy, dataset is not None, envs)])


def _line_of(teacher: str, is_recorded: bool, envs: EpisodeVectorEnv) -> list[Ancestor]:
    if (card := card_of(teacher)) is not None:
        return ancestors(teacher, card)
    if is_recorded and teacher not in policy_names():
        return [Ancestor(name=teacher, cost=TrainingCost())]
    policy = make_policy(teacher, envs)
    if (card := getattr(policy, "card", None)) is not None:
        return ancestors(teacher, card)
    unknown = TrainingCost() if policy.training_steps else UNTRAINED
    return [Ancestor(name=teacher, cost=getattr(policy, "training_cost", None) or unknown)]


def ancestors(name: str, card: AgentCard) -> list[Ancestor]:
    """Return a learned teacher, and what it learned from itself."""
    cost = replace(card.cost, teachers=None, tuning=card.tuning)
    return distinct([Ancestor(name=name, sha256=card.sha256, recipe=card.recipe, cost=cost), *(card.lineage or ())])


def tuning_before(recipe: Recipe, seed: int, folder: Path) -> TuningCost | None:
    """Return what is recorded of the trials that found a recipe, when it is trained in a folder; None: nothing is.

    It is in the recipe's file if `armctl tune` has made it, in the ledger beside the folder, and in that of this
    repository. Finished trainings of the recipe as it is with other seeds are no trials.
    """
    ledger = folder.absolute().parent / TRIALS
    rows = read_trials(ledger) if ledger.exists() else []
    trials = [row for row in rows if row["changed"] or row["ended"] != "finished" or row["seed"] == str(seed)]
    return total_tuning([recipe.tuned, recorded_tuning(recipe.name), tuning_in(trials, recipe.name)])


def recorded_tuning(recipe: str, agents: Path = AGENTS) -> TuningCost | None:
    """Return what the ledger of this repository has on a recipe, besides the published trainings in `agents`."""
    published = {read_card(path).sha256 for path in agents.rglob("*.json")}
    return tuning_in((row for row in read_trials(agents.with_name(TRIALS)) if row["sha256"] not in published), recipe)


def tuning_in(rows: Iterable[Mapping[str, str]], recipe: str) -> TuningCost | None:
    """Return the trials of a recipe among rows of a ledger; None: there are none."""
    minutes = [row["minutes"] for row in rows if row["recipe"] == recipe]
    if not minutes:
        return None
    recorded = [float(number) for number in minutes if number]
    return TuningCost(len(minutes), round(sum(recorded), 1) if recorded else None)

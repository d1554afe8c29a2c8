"""The costs of trainings whose cards are older than the counters, from the learner's options: exactly, or not at all.

Decisions of clones depend on how long the episodes were, and processor time on the machine: both stay unknown.
"""

import math
from collections.abc import Mapping
from typing import Any

from armctl.agents import AgentCard


def recount(card: AgentCard, episode_limit: int) -> dict[str, int]:
    """The costs that are certain, by the names of the card's fields, of a card of armctl's own learners.

    `episode_limit` is the largest number of control steps of an episode, for which SAC's replay waits.
    """
    steps, options = card.training_steps, card.learner_options
    if card.learner == "ppo":
        return {"decisions": steps, "teacher_queries": 0, "gradient_steps": _ppo_updates(steps, options)}
    if card.learner == "sac":
        updates = _sac_updates(steps, options, episode_limit, hindsight=card.env == "armctl/ArmReach-v0")
        return {"decisions": steps, "teacher_queries": 0, "gradient_steps": updates}
    if card.learner in ("bc", "dagger"):
        return {"gradient_steps": steps}
    return {}


def _ppo_updates(steps: int, options: Mapping[str, Any]) -> int:
    """Each rollout of all worlds is passed through `epochs` times, in batches of which the last may be smaller."""
    rollout = options["worlds"] * options["rollout_length"]
    rollouts, rest = divmod(steps, rollout)
    assert not rest
    return int(rollouts * options["epochs"] * math.ceil(rollout / options["batch_size"]))


def _sac_updates(steps: int, options: Mapping[str, Any], episode_limit: int, hindsight: bool) -> int:
    """`gradient_steps` after each control step of all worlds, once there are more steps than random ones.

    Hindsight learns only from finished episodes, and waits until there must be one in each world.
    """
    worlds = options["worlds"]
    waits = max(options["random_steps"], episode_limit * worlds if hindsight and options["relabelled"] else 0)
    return int(options["gradient_steps"] * (steps // worlds - waits // worlds))

"""Comparisons whose figures are made up."""

from typing import Any

from armctl.agents.costs import UNTRAINED
from armctl.study import Comparison
from armctl.verdict.facts import Facts, PolicyFacts

UNTRAINED_POLICY = PolicyFacts("observation", UNTRAINED, 0.0, ())


def facts_of(**known):
    """What is known of a comparison, all of it harmless unless given."""
    values: dict[str, Any] = {
        "env_options": {}, "policy_seed": 0, "planned": 1, "policies": {}, "return_bounds": None, "time_limit": None,
        "control_period": None, "versions": {}, "machine": {}, "notes": [], "failures": {}, "baseline": None,
        "margin": 0.02, "real_time": None, "groups": {}, "disqualified": [], "interrupted": False, "resumed": 0,
    }  # fmt: skip
    return Facts(**values | known)


def made_up(env, results, policies, differences, notes=(), **known):
    """A comparison of seed 0."""
    identity = {"env": env, "seed": 0, "policies": [one.policy for one in policies]}
    found = Comparison(identity, known.get("env_options", {}), facts_of(**known), results)
    found.policies, found.differences, found.notes = policies, differences, list(notes)
    return found

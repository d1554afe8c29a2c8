"""Policies times episodes, to tables and a verdict."""

from armctl.evaluation.compare import Comparison, compare
from armctl.evaluation.rollouts import EpisodeResult, PolicyFailed, evaluate, rollouts

__all__ = ["Comparison", "EpisodeResult", "PolicyFailed", "compare", "evaluate", "rollouts"]

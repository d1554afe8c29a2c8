"""Policies times episodes, to tables and a verdict."""

from armctl.evaluation.compare import Comparison, compare
from armctl.evaluation.demonstrations import collect
from armctl.evaluation.rollouts import EpisodeResult, PolicyFailed, evaluate, rollouts

__all__ = ["Comparison", "EpisodeResult", "PolicyFailed", "collect", "compare", "evaluate", "rollouts"]

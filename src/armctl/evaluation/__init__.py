"""Policies times episodes, to tables and a verdict."""

from armctl.evaluation.compare import Comparison, compare
from armctl.evaluation.demonstrations import collect
from armctl.evaluation.rollouts import EpisodeResult, PolicyFailed, evaluate, rollouts
from armctl.evaluation.sweep import Sweep, sweep

__all__ = [
    "Comparison", "EpisodeResult", "PolicyFailed", "Sweep", "collect", "compare", "evaluate", "rollouts", "sweep",
]  # fmt: skip

"""Evaluation: policies play episodes, and the results become tables and a verdict."""

from armctl.evaluation.compare import compare
from armctl.evaluation.comparison import Comparison
from armctl.evaluation.failures import PolicyFailed
from armctl.evaluation.record import EpisodeResult
from armctl.evaluation.rollouts import evaluate, rollouts
from armctl.evaluation.suite import Suite, suite
from armctl.evaluation.sweep import Sweep, sweep

__all__ = [
    "Comparison", "EpisodeResult", "PolicyFailed", "Suite", "Sweep", "compare", "evaluate", "rollouts", "suite",
    "sweep",
]  # fmt: skip

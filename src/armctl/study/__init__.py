"""Studies: a comparison, a sweep of disturbances, a suite of tasks, and how their folders are read."""

from armctl.study.compare import compare
from armctl.study.comparison import Comparison
from armctl.study.suite import Suite, suite
from armctl.study.sweep import Sweep, sweep

__all__ = ["Comparison", "Suite", "Sweep", "compare", "suite", "sweep"]

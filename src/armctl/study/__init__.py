"""Studies: a comparison, a sweep of disturbances, a suite of tasks, and how their folders are read."""

from armctl.study.compare import compare
from armctl.study.comparison import Comparison
from armctl.study.study import Study
from armctl.study.suite import suite
from armctl.study.sweep import sweep
from armctl.study.task_results import Sweep

__all__ = ["Comparison", "Study", "Sweep", "compare", "suite", "sweep"]

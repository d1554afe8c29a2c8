"""Studies: a comparison, a sweep of disturbances, a suite of tasks, and how their folders are read."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.study.comparison import Comparison
    from armctl.study.study import Study
    from armctl.study.task_results import Sweep
    from armctl.study.verbs import compare, suite, sweep

__all__ = ["Comparison", "Study", "Sweep", "compare", "suite", "sweep"]

__getattr__, __dir__ = on_first_use(__name__)

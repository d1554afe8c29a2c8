"""Studies: a comparison, a sweep of disturbances, a suite of tasks, a search for worst cases; and their folders."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.study.comparison import Comparison
    from armctl.study.mildest_failure import worst_case
    from armctl.study.study import Study
    from armctl.study.task_results import Sweep
    from armctl.study.verbs import compare, suite, sweep
    from armctl.study.worst_case_results import WorstCases

__all__ = ["Comparison", "Study", "Sweep", "WorstCases", "compare", "suite", "sweep", "worst_case"]

__getattr__, __dir__ = on_first_use(__name__)

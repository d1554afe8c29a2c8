"""Tunes recipes and experts: `armctl tune`, with Optuna, on development episodes, at a budget that is written down.

Importing it needs the extra `tune`.
"""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.tuning.candidates import Candidate, candidate_of
    from armctl.tuning.names import tunable
    from armctl.tuning.study import TuningOutcome, tune

__all__ = ["Candidate", "TuningOutcome", "candidate_of", "tunable", "tune"]

__getattr__, __dir__ = on_first_use(__name__)

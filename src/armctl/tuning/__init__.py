"""Tunes recipes and experts: `armctl tune`, with Optuna, on development episodes, at a budget that is written down.

Importing it needs the extra `tune`.
"""

from armctl.tuning.candidates import Candidate, candidate_of, tunable
from armctl.tuning.study import TuningOutcome, tune

__all__ = ["Candidate", "TuningOutcome", "candidate_of", "tunable", "tune"]

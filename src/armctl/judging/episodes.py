"""Trials in the form of armctl's episodes."""

import math
from collections.abc import Mapping, Sequence
from types import NoneType
from typing import Any

import numpy as np

from armctl.core.registration import bare_id
from armctl.episodes.columns import Column, Ragged
from armctl.episodes.table import TYPES, EpisodeTable, column
from armctl.judging.trials import Trial

UNPLAYED: Mapping[type, Any] = {str: "", float: math.nan, int: 0, bool: True}
"""Values of what nobody measured, by type."""


def table_of(env: str, members: Mapping[str, Sequence[Trial]], unknown: Sequence[str]) -> EpisodeTable:
    """Return the episodes, numbered from 0 on for each policy: equal numbers are equal episodes if they are pairs."""
    trials = [(name, k, trial) for name, trials in members.items() for k, trial in enumerate(trials)]
    n = len(trials)
    scored = all(trial.success is not None for _, _, trial in trials)
    outcomes = {True: "success", False: "failure", None: "finished"}
    values: dict[str, list[Any]] = {
        "policy": [name for name, _, _ in trials],
        "env": [bare_id(env)] * n,
        "episode": [k for _, k, _ in trials],
        "outcome": [outcomes[trial.success] for _, _, trial in trials],
        "success": [trial.success if scored else None for _, _, trial in trials],
        "total_reward": [math.nan if "return" in unknown else trial.episode_return for _, _, trial in trials],
        "length": [0 if "steps" in unknown else trial.steps for _, _, trial in trials],
        "worlds": [1] * n,
        "workers": [1] * n,
    }
    columns: dict[str, Column] = {}
    for name, kinds in TYPES.items():
        (kind,) = kinds - {NoneType}
        columns[name] = column(name, values.get(name, [None if NoneType in kinds else UNPLAYED[kind]] * n))
    times = [] if "decision_ms" in unknown else [trial.decision_ms for _, _, trial in trials]
    return EpisodeTable.of_columns(
        columns, [()], np.zeros(n, np.intp), Ragged.of(np.empty(0), [0] * n),
        Ragged.of(np.array(times, float), [len(times) // n] * n),
    )  # fmt: skip

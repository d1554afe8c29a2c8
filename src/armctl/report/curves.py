"""Curves that others have left: of trainings, beside the agents' cards, and of a sweep."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from armctl.errors import ArmctlError, ResultsError
from armctl.evaluation.reproduce import card_path

CURVE_COLUMNS = ("steps", "minutes", "success", "low", "high", "return")
SWEEP_COLUMNS = ("disturbance", "level", "policy", "success", "low", "high")


def training_curves(policies: Sequence[str]) -> tuple[dict[str, pd.DataFrame], list[str]]:
    """Success on held-out episodes against training steps, and what is wrong with curves that are left out.

    By policy: `curve.csv` in a training's folder, beside its `agent.json`, or `name.csv` beside `name.json`.
    """
    curves, problems = {}, []
    for policy in policies:
        try:
            card = card_path(policy)
        except ArmctlError:  # not an agent
            continue
        beside = card.with_name("curve.csv") if card.name == "agent.json" else card.with_suffix(".csv")
        if beside.is_file():
            try:
                curves[policy] = _table(beside, CURVE_COLUMNS, CURVE_COLUMNS)
            except ResultsError as error:
                problems.append(str(error))
    return curves, problems


def read_sweep(path: Path) -> pd.DataFrame:
    """A row for each disturbance, level and policy; raises `ResultsError`."""
    return _table(path, SWEEP_COLUMNS, ("level", "success", "low", "high")).astype({"policy": str, "disturbance": str})


def _table(path: Path, columns: Sequence[str], numbers: Sequence[str]) -> pd.DataFrame:
    """A CSV file with at least these columns, some of which are numbers, and a row; raises `ResultsError`."""
    try:
        table = pd.read_csv(path)
        if missing := [column for column in columns if column not in table]:
            raise ValueError(f"it has no column {missing[0]}")
        if table.empty:
            raise ValueError("it has no row")
        return table.astype(dict.fromkeys(numbers, float))
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path} cannot be read: {error}") from error

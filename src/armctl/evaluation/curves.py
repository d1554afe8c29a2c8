"""Reads curves from CSV files: success during a training (`curve.csv`) and under disturbances (`sweep.csv`)."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from armctl.errors import ArmctlError, ResultsError
from armctl.evaluation.reproduce import card_path

CURVE = "curve.csv"
CURVE_COLUMNS = ("steps", "minutes", "success", "low", "high", "return")
"""Of held-out episodes: after how many steps and minutes of training, success with its 95 % interval, mean return."""
SWEEP_COLUMNS = ("disturbance", "level", "policy", "success", "low", "high")


def training_curves(policies: Sequence[str]) -> tuple[dict[str, pd.DataFrame], list[str]]:
    """The learning curve of each agent that has one beside its card, and error messages for unreadable curves.

    The curve is `curve.csv` in a training's folder, beside its `agent.json`; for a card `name.json`, it is `name.csv`.
    """
    curves, problems = {}, []
    for policy in policies:
        try:
            card = card_path(policy)
        except ArmctlError:  # not an agent
            continue
        beside = card.with_name(CURVE) if card.name == "agent.json" else card.with_suffix(".csv")
        if beside.is_file():
            try:
                curves[policy] = read_curve(beside)
            except ResultsError as error:
                problems.append(str(error))
    return curves, problems


def read_curve(path: Path) -> pd.DataFrame:
    """A learning curve: a row per evaluation, with `CURVE_COLUMNS`. Raises `ResultsError`."""
    return _table(path, CURVE_COLUMNS, CURVE_COLUMNS)


def read_sweep(path: Path) -> pd.DataFrame:
    """A sweep: a row per disturbance, level and policy, with `SWEEP_COLUMNS` at least. Raises `ResultsError`."""
    return _table(path, SWEEP_COLUMNS, ("level", "success", "low", "high")).astype({"policy": str, "disturbance": str})


def _table(path: Path, columns: Sequence[str], numbers: Sequence[str]) -> pd.DataFrame:
    """A CSV file with these `columns` and at least one row; the `numbers` columns as floats. Raises `ResultsError`."""
    try:
        table = pd.read_csv(path)
        if missing := [column for column in columns if column not in table]:
            raise ValueError(f"it has no column {missing[0]}")
        if table.empty:
            raise ValueError("it has no row")
        return table.astype(dict.fromkeys(numbers, float))
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path} cannot be read: {error}") from error

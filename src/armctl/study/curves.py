"""Reads learning curves: success during a training (`curve.csv`)."""

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from armctl.agents import read_card
from armctl.core.errors import ArmctlError, ResultsError, reason
from armctl.core.files import bounded_text
from armctl.envs import full_id
from armctl.policies.trainings import card_path

CURVE = "curve.csv"
CURVE_COLUMNS = ("steps", "minutes", "success", "low", "high", "return")
"""Columns: steps and minutes of training, success in held-out episodes with its 95 % interval, mean return."""
COSTS = ("decisions", "processor_seconds")
"""Control steps in simulation and processor time so far; NaN in a curve without them."""


def training_curves(
    policies: Sequence[str], env: str, env_options: Mapping[str, Any]
) -> tuple[dict[str, pd.DataFrame], list[str]]:
    """Return the learning curve of each agent that has one beside its card, and error messages for unreadable curves.

    It is of the card's environment and options: where these are others than `env` and `env_options`, it is left out.
    """
    curves, problems = {}, []
    for policy in policies:
        try:
            card = card_path(policy)
        except ArmctlError:  # not an agent
            continue
        beside = curve_path(card)
        if beside.is_file():
            try:
                trained = read_card(card)
                if (full_id(trained.env), trained.env_options) == (full_id(env), dict(env_options)):
                    curves[policy] = read_curve(beside)
            except ArmctlError as error:
                problems.append(str(error))
    return curves, problems


def curve_path(card: Path) -> Path:
    """Return the path of an agent's learning curve: `curve.csv` beside `agent.json`, `name.csv` by `name.json`."""
    return card.with_name(CURVE) if card.name == "agent.json" else card.with_suffix(".csv")


def read_curve(path: Path) -> pd.DataFrame:
    """Read a learning curve: a row per evaluation, with `CURVE_COLUMNS` and `COSTS`. Raise `ResultsError`."""
    table = _table(path, CURVE_COLUMNS, (*CURVE_COLUMNS, *COSTS))
    return table.assign(**dict.fromkeys(set(COSTS) - set(table), math.nan))


def _table(path: Path, columns: Sequence[str], numbers: Sequence[str]) -> pd.DataFrame:
    """Read a CSV file with these `columns`, the `numbers` as floats, and at least one row. Raise `ResultsError`."""
    try:
        table = pd.read_csv(io.StringIO(bounded_text(path)), dtype=dict.fromkeys(numbers, float))
        if missing := [column for column in columns if column not in table]:
            raise ValueError(f"it has no column {missing[0]}")
        if table.empty:
            raise ValueError("it has no row")
        if table[[column for column in columns if column not in numbers]].isna().any(axis=None):
            raise ValueError("it has a row without a name")
        return table
    except (OSError, ValueError) as error:
        raise ResultsError(f"{path} cannot be read: {reason(error)}") from error

"""Reads curves from CSV files: success during a training (`curve.csv`) and under disturbances (`sweep.csv`)."""

import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
from pydantic import Field, TypeAdapter

from armctl.agents import read_card
from armctl.core.errors import ArmctlError, ResultsError
from armctl.core.files import bounded_text, digest, unsealed
from armctl.envs import full_id
from armctl.episodes.store import STORE, read_identity
from armctl.stats.robustness import Pair, PairTest
from armctl.study.reproduce import card_path

CURVE = "curve.csv"
CURVE_COLUMNS = ("steps", "minutes", "success", "low", "high", "return")
"""Of held-out episodes: after how many steps and minutes of training, success with its 95 % interval, mean return."""
COSTS = ("decisions", "processor_seconds")
"""Control steps in simulation and processor time so far; NaN in curves of older versions."""
SWEEP, POINTS, COMPARISONS = "sweep.json", "sweep.csv", "comparisons"
"""Files of a sweep, and the first's key for the identities of its comparisons."""
LOOKS = "looks"
"""The key of `Sweep.looks`, there and in the table's attributes."""
RECORDED = "real_time"
"""The key, in the first of them and in its table's attributes, of the folder whose decision times were repeated."""
PAIRS = "paired"
"""The key of the tests of each two policies: `[disturbance, level, policy, policy, p, lead]`, as in `Sweep.pairs`."""
SWEEP_COLUMNS = ("disturbance", "level", "policy", "success", "low", "high")


def training_curves(
    policies: Sequence[str], env: str, env_options: Mapping[str, Any]
) -> tuple[dict[str, pd.DataFrame], list[str]]:
    """The learning curve of each agent that has one beside its card, and error messages for unreadable curves.

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
    """Where an agent's learning curve is, if it has one: `curve.csv` beside `agent.json`, `name.csv` by `name.json`."""
    return card.with_name(CURVE) if card.name == "agent.json" else card.with_suffix(".csv")


def read_curve(path: Path) -> pd.DataFrame:
    """A learning curve: a row per evaluation, with `CURVE_COLUMNS` and `COSTS`. Raises `ResultsError`."""
    table = _table(path, CURVE_COLUMNS, (*CURVE_COLUMNS, *COSTS))
    return table.assign(**dict.fromkeys(set(COSTS) - set(table), math.nan))


def read_sweep(folder: Path) -> pd.DataFrame:
    """A sweep: a row per disturbance, level and policy, with `SWEEP_COLUMNS` at least. Raises `ResultsError`."""
    path = folder / POINTS
    try:
        told = unsealed(bounded_text(folder / SWEEP))
        looks = TypeAdapter(list[int]).validate_python(told.get(LOOKS, []))
        if told.get(POINTS) != digest(bounded_text(path)):
            raise ValueError(f"it does not have the checksum in {SWEEP}: it was changed, or damaged")
        for name, own in dict(told.get(COMPARISONS, {})).items():
            if (folder / name / STORE).exists() and comparison_in(folder / name) != own:
                raise ValueError(f"{folder / name} holds another comparison by now: run the sweep again")
    except (OSError, ValueError, TypeError) as error:
        raise ResultsError(f"{path} cannot be read: {error}") from error
    table = _table(path, SWEEP_COLUMNS, ("level", "success", "low", "high")).astype({"policy": str, "disturbance": str})
    table.attrs |= {RECORDED: told.get(RECORDED), LOOKS: looks}
    return table


def read_pairs(folder: Path) -> dict[Pair, PairTest]:
    """The tests of each two policies of a sweep; none in sweeps of older versions. Raises `ResultsError`."""
    p, lead = Annotated[float, Field(ge=0, le=1)], Annotated[float, Field(ge=-1, le=1)]
    kind = TypeAdapter(list[tuple[str, float, str, str, p, lead]])  # type: ignore[valid-type]
    try:
        found = kind.validate_python(unsealed(bounded_text(folder / SWEEP)).get(PAIRS, []))
    except (OSError, ValueError) as error:
        raise ResultsError(f"{folder / SWEEP} cannot be read: {error}") from error
    return {(name, level, frozenset((a, b))): PairTest(p, lead) for name, level, a, b, p, lead in found}


def comparison_in(folder: Path) -> str:
    """The digest of the identity of a folder's comparison. Raises `ResultsError`."""
    return digest(read_identity(folder))


def _table(path: Path, columns: Sequence[str], numbers: Sequence[str]) -> pd.DataFrame:
    """A CSV file with these `columns` and at least one row; the `numbers` columns as floats. Raises `ResultsError`."""
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
        raise ResultsError(f"{path} cannot be read: {error}") from error

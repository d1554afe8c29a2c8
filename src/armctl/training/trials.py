"""The record of every training that was tried, those that failed too: `trials.csv`, a row each.

Who tries ten trainings and shows the best one has to say so. `armctl train` appends to the file beside its folder.
"""

import contextlib
import csv
import io
import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import filelock

from armctl.agents import AgentCard
from armctl.core.errors import ArmctlError, ResultsError, reason
from armctl.core.files import bounded_text, write_atomically
from armctl.study.curves import CURVE, read_curve

TRIALS = "trials.csv"
COLUMNS = (
    "date", "recipe", "changed", "env", "learner", "seed", "steps", "minutes", "ended", "note",
    "success", "low", "high", "episodes", "episode_seed", "sha256",
)  # fmt: skip
"""`changed` is what differs from the recipe, as JSON; `seed` is the training's. `ended` is `finished`, `interrupted`,
`pruned` or `failed`, and `note` the reason. `success` has its 95 % interval, over `episodes` of `episode_seed`;
`sha256` is the agent's. What is unknown is empty."""
CLOCK, CHECKPOINTS = "clock.json", "checkpoints"
"""Names in a training's folder: the file of what it has spent, and the folder of its checkpoints, `STEPS.zip`."""
PATIENCE = 60.0
"""s to wait for another process that writes a row."""


def trial_row(
    recipe: str, learner: str, env: str, seed: int | None, changed: Mapping[str, Any], ending: str, note: str = ""
) -> dict[str, Any]:
    """Return a row without results; `changed` may have empty values, which are left out."""
    changes = {name: value for name, value in changed.items() if value not in (None, {}, "")}
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "recipe": recipe,
        "changed": json.dumps(changes, default=str, sort_keys=True) if changes else "",
        "env": env,
        "learner": learner,
        "seed": seed,
        "ended": ending,
        "note": note,
    }


def results_of(card: AgentCard) -> dict[str, Any]:
    """Return what a finished training's card adds to its row."""
    results: dict[str, Any] = {
        "steps": card.training_steps,
        "minutes": card.training_minutes,
        "sha256": card.sha256,
    }
    if (evaluation := card.judgement) is not None:
        low, high = evaluation.success_interval
        results |= {"success": evaluation.success_rate, "low": round(low, 4), "high": round(high, 4)}
        results |= {"episodes": evaluation.episodes, "episode_seed": evaluation.seed}
    return results


def progress_of(folder: Path) -> dict[str, Any]:
    """Return what the newest checkpoint and the learning curve of an unfinished training add to its row."""
    progress: dict[str, Any] = {}
    with contextlib.suppress(OSError, ValueError, ArmctlError, IndexError, OverflowError):
        last = read_curve(folder / CURVE).iloc[-1]
        progress = {"steps": int(last["steps"]), "minutes": float(last["minutes"])}
    if (newest := newest_checkpoint(folder)) is not None and int(newest.stem) > progress.get("steps", -1):
        progress["steps"] = int(newest.stem)
        with contextlib.suppress(OSError, ValueError, KeyError, TypeError):
            progress["minutes"] = round(float(json.loads(bounded_text(folder / CLOCK))["seconds"]) / 60, 3)
    return progress


def newest_checkpoint(folder: Path) -> Path | None:
    """Return the checkpoint with the most steps in a training's folder."""
    checkpoints = (path for path in (folder / CHECKPOINTS).glob("*.zip") if path.stem.isdecimal())
    return max(checkpoints, key=lambda path: int(path.stem), default=None)


def check_trials(file: Path) -> None:
    """Raise `ResultsError` if no row can be added to a file, before hours are spent on one."""
    try:
        if file.exists():
            read_trials(file)
    except (OSError, ValueError, csv.Error) as error:
        why = f"cannot record trainings ({reason(error)}): rename it, or choose another folder (--out)"
        raise ResultsError(f"{file} {why}") from error


def add_trial(file: Path, row: Mapping[str, Any]) -> None:
    """Append a row; other processes may do so at the same time. Rows and columns that are there are kept.

    Raises `ResultsError`, which has the row, if the file cannot be read or written; it then stays as it was.
    """
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with filelock.FileLock(file.with_name(f".{file.name}.lock"), timeout=PATIENCE):
            rows = read_trials(file) if file.exists() else []
            write_trials(file, [*rows, row])
    except (OSError, ValueError, csv.Error) as error:  # a lock's Timeout is an OSError
        why = getattr(error, "strerror", None) or error
        text = json.dumps({name: value for name, value in row.items() if value not in (None, "")}, default=str)
        raise ResultsError(f"the training cannot be recorded in {file} ({why}); its row is {text}") from error


def write_trials(file: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Replace all rows. Columns are `COLUMNS` and further ones of the first row. Raises `OSError`."""
    columns = list(dict.fromkeys((*COLUMNS, *(rows[0] if rows else ()))))
    table = io.StringIO()
    writer = csv.DictWriter(table, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_atomically(file, table.getvalue())


def read_trials(file: Path) -> list[dict[str, str]]:
    """Return all rows, as text; what another version did not record is empty.

    Raises `OSError` or `ValueError`, also for another file of that name, such as one of `armctl log`.
    """
    reader = csv.DictReader(io.StringIO(bounded_text(file)), strict=True)
    rows = list(reader)
    if "recipe" not in (reader.fieldnames or ["recipe"]):
        raise ValueError("it is no record of trainings: it has no column recipe")
    for line, row in enumerate(rows, start=2):
        if None in row or None in row.values():
            raise ValueError(f"line {line} does not have as many values as there are columns")
    return [dict.fromkeys(COLUMNS, "") | row for row in rows]

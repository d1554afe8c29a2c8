"""armctl's own results folders: the episodes in their stores."""

from pathlib import Path

from armctl.episodes.stored import UNDISTURBED
from armctl.judging.rows import Rows
from armctl.study.names import SUITE
from armctl.study.results import read_study
from armctl.verdict.facts import Facts

COLUMNS = {"policy": "policy", "episode": "episode", "seed": "seed", "success": "success", "return": "total_reward",
           "steps": "length"}  # fmt: skip

PACKAGES = ("armctl-suite", "mujoco")
"""Packages whose versions have to be equal."""


def read(folder: Path) -> list[Rows]:
    """Read the episodes of all cells of a results folder. Raises `ResultsError`."""
    study, parts = read_study(folder), []
    for name, comparison in study.cells.items():
        task, _, setting = name.rpartition("/") if study.kind == SUITE else ("", "", name)
        counted = list(comparison.counted.values())
        columns = [[value for table in counted for value in table.column(field).tolist()] for field in COLUMNS.values()]
        values = list(map(list, zip(*columns, strict=True)))
        facts, condition = comparison.facts, {} if setting == UNDISTURBED else {"condition": setting}
        parts.append(
            Rows(
                source=str(folder), headings=list(COLUMNS), values=values, places=range(1, len(values) + 1),
                unit="row", is_known_format=True, constants={"task": task or comparison.env} | condition,
                time_limit=facts.time_limit, return_bounds=facts.return_bounds, setup=_setup(facts),
            )
        )  # fmt: skip
    return parts


def _setup(facts: Facts) -> dict[str, str]:
    """Return what makes episodes of an environment comparable, in words."""
    options = ", ".join(f"{name}={value}" for name, value in sorted(facts.env_options.items()))
    real_time = ", ".join(f"{name} {value}" for name, value in (facts.real_time or {}).items())
    packages = {f"version of {name}": facts.versions[name] for name in PACKAGES if name in facts.versions}
    return {"options": options or "default", "real time": real_time or "off", **packages}

"""Writes a judgement of results that armctl did not play: pages, tables and the verdict as text."""

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path

from armctl.core.console import printable
from armctl.core.errors import ResultsError, os_errors_as
from armctl.core.files import write_atomically
from armctl.episodes.output import DECISIONS, EPISODES, write_csv
from armctl.episodes.stored import STORE, UNDISTURBED
from armctl.judging.result import Judgement, Outcome
from armctl.report.formats import markdown, markdown_text
from armctl.report.page import REPORT, write_task_page
from armctl.study.comparison import Comparison
from armctl.study.output import SUMMARY, summary
from armctl.study.task_results import Sweep

VERDICT = "verdict.md"
MARKS: Mapping[Outcome, str] = {"better": "🟢", "worse": "🔴", "equivalent": "🟡", "undecided": "⚪"}


def badge(judgement: Judgement) -> str:
    """Return a line of Markdown for each pair of the verdict, and each task or condition where one is missing."""
    lines = [f"{MARKS[end.outcome]} **{markdown_text(str(end))}**" for end in judgement.conclusions]
    lines += [f"{MARKS['undecided']} **{markdown_text(text)}**" for text in judgement.not_compared]
    return printable("\n".join(lines) or "⚪ **no verdict**")


def write_judgement(judgement: Judgement, folder: Path, overwrite: bool = False) -> Path:
    """Write `verdict.md`, `report.html`, `episodes.csv` and `summary.json`; return the path of the report.

    Each of several tasks and conditions has a folder in it with the same. `episodes.csv` has the episodes as they were
    read: what is unknown is empty or 0 there.

    Raises `ResultsError` if the folder has such files, unless `overwrite`, or cannot be written.
    """
    forbidden = (STORE,) if overwrite else (STORE, VERDICT, REPORT)
    if any(os.path.lexists(folder / name) for name in forbidden):
        raise ResultsError(
            f"{folder} holds results already: choose another folder, or --overwrite what judge has written"
        )
    pages = {folder: judgement.overall} if judgement.overall is not None else {}
    if len(judgement.cells) > 1:
        names = {name: re.sub(r"[^\w.+=-]+", "_", name)[:80] for name in judgement.cells}
        for i, (name, comparison) in enumerate(judgement.cells.items()):
            unique = names[name] if [*names.values()].count(names[name]) == 1 else f"{names[name]}-{i}"
            pages[folder / unique] = comparison
    with os_errors_as(f"results cannot be written to {folder}"):
        folder.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / VERDICT, f"{badge(judgement)}\n\n{printable(markdown(judgement.document()))}")
        for place, comparison in pages.items():
            place.mkdir(exist_ok=True)
            _write(comparison, place)
    return folder / REPORT if judgement.overall is not None else folder / VERDICT


def _write(comparison: Comparison, folder: Path) -> None:
    write_csv(folder, comparison.results)
    (folder / DECISIONS).unlink()
    assert (folder / EPISODES).exists()
    write_atomically(folder / SUMMARY, json.dumps(summary(comparison), indent=2) + "\n")
    swept = Sweep(comparison.env, comparison.seed, {}, {}, "", {UNDISTURBED: comparison}, {}, False)
    write_task_page(swept, folder / REPORT, folder.resolve().name, False, lambda doing: None)

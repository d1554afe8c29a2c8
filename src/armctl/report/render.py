"""Renders pages: one HTML file that makes no network requests."""

import base64
import functools
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from armctl.agents.costs import TrainingCost, rounded
from armctl.core.errors import os_errors_as
from armctl.core.files import write_atomically
from armctl.report import style
from armctl.report.colours import DARK, on_both
from armctl.report.plots import mean, percent, spread
from armctl.verdict.summary_tables import trained, trainings_in_words


def write_page(out: Path, template: str, page: Mapping[str, Any]) -> None:
    """Write a page, everything in which is escaped. Raises `ResultsError` if it cannot be written."""
    written = datetime.now().strftime("%Y-%m-%d %H:%M")
    text = _environment().get_template(template).render(page, written=written, dark=DARK, plotly=Markup(get_plotlyjs()))
    with os_errors_as(f"the report {out} cannot be written"):
        write_atomically(out, text)


@functools.cache
def _environment() -> jinja2.Environment:
    """Return the templates, which are compiled once."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("armctl.report", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "percent": percent,
        "mean": mean,
        "number": style.number,
        "spread": spread,
        "base64": _base64,
        "on_both": on_both,
        "trainings": trainings_in_words,
        "training": trained,
        "training_more": _training_more,
    }
    return environment


def _training_more(cost: TrainingCost) -> str:
    """Return the small print about a training: what it took, each on a line."""
    tuning, teachers, local_decisions = cost.tuning, cost.teachers, cost.decisions
    cost = TrainingCost() if cost.is_untrained else cost.total
    counts = {"gradient steps": cost.gradient_steps, "teacher queries": cost.teacher_queries or None}
    parts = ["decisions"] if cost.decisions else []
    if teachers is not None and local_decisions is not None and teachers.decisions is not None:
        parts += [f"{rounded(local_decisions)} its own", f"{rounded(teachers.decisions)} its teachers'"]
    parts += [f"{rounded(count)} {unit}" for unit, count in counts.items() if count is not None]
    if cost.processor_seconds is not None:
        parts.append(f"{cost.processor_seconds / 60:.1f} processor minutes")
    if cost.minutes:
        parts.append(f"{cost.minutes:.1f} minutes")
    if tuning is not None:
        parts.append(f"tuning: {tuning}")
    return "\n".join(parts)


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")

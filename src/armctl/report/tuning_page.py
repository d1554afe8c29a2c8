"""What a tuning found: a table for the terminal, and a page with Optuna's own plots."""

import warnings
from pathlib import Path
from typing import Any

import optuna
import optuna.visualization as plots
import plotly.graph_objects as go
from optuna.importance import PedAnovaImportanceEvaluator
from optuna.trial import TrialState

from armctl.report.colours import COLOURS
from armctl.report.plots import Plot
from armctl.report.render import write_page
from armctl.report.style import dress
from armctl.tuning import TuningOutcome
from armctl.verdict.tables import UNKNOWN, Cell, Column, Document, Remark, Table

PAGE = "tuning.html"
HEIGHT, MARGIN = 380, {"l": 56, "r": 16, "t": 24, "b": 48}
"""px."""
LEAST = 4
"""Finished trials from which on it is worth telling which options matter."""

BEST_OF_MANY = (
    "Whether they are better on new episodes, or in new trainings, is still to be shown: the best of many trials looks "
    "better than it is."
)


def document(found: TuningOutcome) -> Document:
    """The present and the best values beside each other, and what they cost."""
    before, best = found.present_trial, found.best
    shown = {"present": before} | ({"best": best} if best is not before else {})
    columns = [Column(found.candidate.name), *(Column(name) for name in shown)]
    rows = [[Cell("trial"), *(_number(one and one.number) for one in shown.values())]]
    rows += [
        [Cell(path), *(_number(one and one.params[path]) for one in shown.values())] for path in found.candidate.space
    ]
    rows.append([Cell(found.candidate.score), *(_number(one and one.value) for one in shown.values())])
    records = [
        {"values": name, "trial": one.number, found.candidate.score: one.value} | one.params
        for name, one in shown.items()
        if one
    ]
    parts: list[Table | Remark] = [Table("values", "", columns, rows, records, f"By {found.candidate.judged_by}.")]
    parts.append(Remark(_spent(found)))
    if best is None:
        parts.append(Remark("No trial has finished.", "note"))
    elif best is before:
        parts.append(Remark("No values are better than the present ones.", "verdict"))
    else:
        parts.append(Remark(f"{found.best_file.name} has the best values. {BEST_OF_MANY}", "verdict"))
    return Document(parts, {"tuned": found.candidate.name, "processor_seconds": found.processor_seconds})


def write_tuning_page(found: TuningOutcome) -> Path:
    """Write the page into the tuning's folder, and return its path. Raises `ResultsError`."""
    out = found.folder / PAGE
    shown = document(found)
    write_page(out, "tuning.html.j2", {
        "name": found.candidate.name,
        "table": shown.tables[0],
        "remarks": [part.text for part in shown.parts if isinstance(part, Remark)],
        "plots": _plots(found),
        "interrupted": found.interrupted,
    })  # fmt: skip
    return out


def _spent(found: TuningOutcome) -> str:
    states = [one.state for one in found.trials]
    counts = {
        "finished": states.count(TrialState.COMPLETE),
        "pruned": states.count(TrialState.PRUNED),
        "failed": states.count(TrialState.FAIL),
    }
    told = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
    return f"{len(states)} trials ({told or 'none ended'}) in {found.processor_seconds / 60:.1f} processor minutes."


def _plots(found: TuningOutcome) -> list[Plot]:
    """Optuna's plots, as far as there are trials enough for them."""
    study, score = found.study, found.candidate.score
    made = [_plot(plots.plot_timeline(study), "Times", "When each trial ran.")]
    if any(one.intermediate_values for one in found.trials):
        note = "Reports of each trial; those that end early were pruned."
        made.append(_plot(plots.plot_intermediate_values(study), "Curves", note))
    if len(found.finished) >= LEAST and len(found.candidate.space) > 1:
        with warnings.catch_warnings(action="ignore", category=optuna.exceptions.ExperimentalWarning):
            evaluator = PedAnovaImportanceEvaluator()
            importances = plots.plot_param_importances(study, evaluator=evaluator, target_name=score)
        made.append(_plot(importances, "What matters", "Importance by PED-ANOVA (Watanabe et al., IJCAI 2023)."))
    if found.finished:
        history = plots.plot_optimization_history(study, target_name=score)
        made += [
            _plot(plots.plot_parallel_coordinate(study, target_name=score), "Together", "Each line is a trial."),
            _plot(plots.plot_slice(study, target_name=score), "Options", "Each trial by the value of each option."),
            _plot(history, "History", "Each trial, and the best so far."),
        ]
    return made[::-1]


def _plot(figure: go.Figure, title: str, note: str) -> Plot:
    figure.update_layout(title=None, template="none", colorway=COLOURS, width=None, autosize=True)
    dress(figure, HEIGHT, MARGIN)
    figure.for_each_xaxis(lambda axis: axis.update(nticks=4, tickangle=0, exponentformat="power"))
    figure.update_xaxes(selector={"type": "log"}, dtick=1, tickfont_size=9)
    figure.for_each_xaxis(lambda axis: axis.update(title_text=(axis.title.text or "").rpartition(".")[2]))
    return Plot(figure, f"{title}: {note}", title, note)


def _number(value: Any) -> Cell:
    if value is None:
        return Cell(UNKNOWN)
    return Cell(f"{value:.4g}" if isinstance(value, float) else str(value))

"""The result of a tuning: a table for the terminal, and a page with Optuna's own plots."""

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
MIN_TRIALS = 4
"""Finished trials from which on it is worth telling which options matter."""

BEST_OF_MANY = (
    "Whether they are better on new episodes, or in new trainings, is still to be shown: the best of many trials looks "
    "better than it is."
)


def document(outcome: TuningOutcome) -> Document:
    """Return the present and the best values beside each other, and what they cost."""
    present, best = outcome.present_trial, outcome.best
    trials = {"present": present} | ({"best": best} if best is not present else {})
    columns = [Column(outcome.candidate.name), *(Column(name) for name in trials)]
    rows = [[Cell("trial"), *(_number(trial and trial.number) for trial in trials.values())]]
    rows += [
        [Cell(path), *(_number(trial and trial.params[path]) for trial in trials.values())]
        for path in outcome.candidate.space
    ]
    rows.append([Cell(outcome.candidate.score), *(_number(trial and trial.value) for trial in trials.values())])
    records = [
        {"values": name, "trial": trial.number, outcome.candidate.score: trial.value} | trial.params
        for name, trial in trials.items()
        if trial
    ]
    parts: list[Table | Remark] = [Table("values", "", columns, rows, records, f"By {outcome.candidate.judged_by}.")]
    parts.append(Remark(_spent(outcome)))
    if best is None:
        parts.append(Remark("No trial has finished.", "note"))
    elif best is present:
        parts.append(Remark("No values are better than the present ones.", "verdict"))
    else:
        parts.append(Remark(f"{outcome.best_file.name} has the best values. {BEST_OF_MANY}", "verdict"))
    return Document(parts, {"tuned": outcome.candidate.name, "processor_seconds": outcome.processor_seconds})


def write_tuning_page(outcome: TuningOutcome) -> Path:
    """Write the page into the tuning's folder, and return its path. Raises `ResultsError`."""
    out = outcome.folder / PAGE
    document_parts = document(outcome)
    write_page(out, "tuning.html.j2", {
        "name": outcome.candidate.name,
        "table": document_parts.tables[0],
        "remarks": [part.text for part in document_parts.parts if isinstance(part, Remark)],
        "plots": _plots(outcome),
        "interrupted": outcome.interrupted,
    })  # fmt: skip
    return out


def _spent(outcome: TuningOutcome) -> str:
    states = [trial.state for trial in outcome.trials]
    counts = {
        "finished": states.count(TrialState.COMPLETE),
        "pruned": states.count(TrialState.PRUNED),
        "failed": states.count(TrialState.FAIL),
    }
    spent = ", ".join(f"{count} {label}" for label, count in counts.items() if count)
    return f"{len(states)} trials ({spent or 'none ended'}) in {outcome.processor_seconds / 60:.1f} processor minutes."


def _plots(outcome: TuningOutcome) -> list[Plot]:
    """Optuna's plots, as far as there are trials enough for them."""
    study, score = outcome.study, outcome.candidate.score
    figures = [_plot(plots.plot_timeline(study), "Times", "When each trial ran.")]
    if any(trial.intermediate_values for trial in outcome.trials):
        note = "Reports of each trial; those that end early were pruned."
        figures.append(_plot(plots.plot_intermediate_values(study), "Curves", note))
    if len(outcome.finished) >= MIN_TRIALS and len(outcome.candidate.space) > 1:
        with warnings.catch_warnings(action="ignore", category=optuna.exceptions.ExperimentalWarning):
            evaluator = PedAnovaImportanceEvaluator()
            importances = plots.plot_param_importances(study, evaluator=evaluator, target_name=score)
        figures.append(_plot(importances, "What matters", "Importance by PED-ANOVA (Watanabe et al., IJCAI 2023)."))
    if outcome.finished:
        history = plots.plot_optimization_history(study, target_name=score)
        figures += [
            _plot(plots.plot_parallel_coordinate(study, target_name=score), "Together", "Each line is a trial."),
            _plot(plots.plot_slice(study, target_name=score), "Options", "Each trial by the value of each option."),
            _plot(history, "History", "Each trial, and the best so far."),
        ]
    return figures[::-1]


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

"""Writes the report of a results folder: one HTML file that makes no network requests."""

import base64
import itertools
import shlex
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd
import plotly.graph_objects as go
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from armctl.envs import make_worlds
from armctl.errors import ArmctlError, ResultsError
from armctl.evaluation.curves import read_sweep, training_curves
from armctl.evaluation.record import EpisodeResult
from armctl.evaluation.results import Results, read_results
from armctl.evaluation.statistics import Estimate
from armctl.evaluation.store import COMPARISON
from armctl.evaluation.sweep import POINTS, UNDISTURBED
from armctl.evaluation.verdict import verdict
from armctl.files import write_atomically
from armctl.report import figures, style
from armctl.report.videos import film, most_different, names_code, worst

REPORT = "report.html"
NOTHING = "\u2013"
MOST_PAIRS = 6
"""If there are more pairs of policies than this, only those with the best policy are shown."""


@dataclass(frozen=True)
class Plot:
    """A figure with its texts."""

    figure: go.Figure
    alt_text: str
    title: str = ""
    note: str = ""

    @property
    def json(self) -> Markup:
        """The figure as JSON for Plotly's JavaScript, escaped so that it can stand in a script element."""
        text = str(self.figure.to_json())
        return Markup(text.replace("<", r"\u003c").replace(">", r"\u003e").replace("&", r"\u0026"))


def write_report(
    folder: str | Path,
    out: str | Path | None = None,
    *,
    video: bool = True,
    trusted: bool = False,
    progress: Callable[[str], None] = lambda doing: None,
) -> Path:
    """Write the report of a comparison's or a sweep's folder to `out` (`folder/report.html`), and return its path.

    With `video`, some episodes are played again; if that is impossible, the report says why. Policies given as code
    (`module:function`) are called only if the folder is `trusted`. `progress` is called with what is being done.

    Raises `ResultsError` for a folder without results, or with damaged ones, and if the report cannot be written.
    """
    folder = Path(folder)
    out = folder / REPORT if out is None else Path(out)
    sweep = read_sweep(folder / POINTS) if (folder / POINTS).exists() else None
    home = folder if sweep is None or (folder / COMPARISON).exists() else folder / UNDISTURBED
    if not folder.is_dir() or (sweep is None and not (home / COMPARISON).exists()):
        raise ResultsError(f"{folder} holds no results: armctl compare --out {folder} writes some")
    results = read_results(home) if (home / COMPARISON).exists() else None
    names = list(results.names) if results else []
    if sweep is not None:
        names += [name for name in sweep.policy.unique() if name not in names]
    look = style.looks(names)
    page: dict[str, Any] = {
        "look": look,
        "written": datetime.now().strftime("%Y-%m-%d %H:%M"),
        "folder": folder.resolve().name,
        "robustness": [] if sweep is None else _robustness(sweep, look),
        "swept": [] if sweep is None else [look[name] for name in sweep.policy.unique()],
        "results": results,
        "together": [],
        "lowest": [],
    }
    if results is not None:
        progress("drawing figures")
        page |= _comparison(results, look, trusted)
        if sweep is not None:
            page["command"] = f"{_command('sweep', results, page['extent'], results.names)}{_disturbances(sweep)}"
        page |= _videos(results, trusted, progress) if video else {"no_videos": "They were left out (--no-video)."}
    progress("writing")
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("armctl.report", "."),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "percent": _percent,
        "mean": _mean,
        "number": style.number,
        "spread": _spread,
        "base64": _base64,
    }
    text = environment.get_template("page.html.j2").render(page, plotly=Markup(get_plotlyjs()))
    try:
        write_atomically(out, text)
    except OSError as error:
        raise ResultsError(f"the report {out} cannot be written: {error.strerror}") from error
    return out


def _comparison(results: Results, look: style.Looks, trusted: bool) -> dict[str, Any]:
    """Everything on the page about a comparison, except for videos."""
    comparison, episodes = results.comparison, results.episodes
    policies = comparison.policies
    planned = policies[0].planned if policies else 0
    extent = f"--episodes {planned}" if planned else ""
    sentence = _verdict(results)
    for name in sorted(look, key=len, reverse=True):
        sentence = sentence.replace(name, look[name].label)
    headline, _, rest = sentence.partition("; ")
    page: dict[str, Any] = {
        "headline": headline,
        "lead": rest,
        "planned": planned,
        "extent": extent,
        "command": _command("compare", results, extent, results.names),
        "missing": [name for name in results.names if name not in episodes],
    }
    if not policies:
        return page
    terms = figures.term_means(episodes)
    term_look = {
        term: style.Look(term, style.TERM_COLOURS[i % len(style.TERM_COLOURS)])
        for i, term in enumerate(dict.fromkeys(itertools.chain(*terms.values())))
    }
    curves, problems = training_curves([policy.policy for policy in policies])
    period = _period(results, trusted)
    return page | {
        "shown": [look[name] for name in episodes],
        "success": Plot(
            figures.success_bars(policies, look),
            "; ".join(f"{policy.policy}: success {_percent(policy.success)}" for policy in policies),
        ),
        "profile": Plot(figures.profile(episodes, look), "Share of episodes above each return, by policy"),
        "paired": _paired(results, look),
        "reward_terms": Plot(
            figures.reward_terms(terms, look, term_look),
            "; ".join(
                f"{name}: " + ", ".join(f"{term} {value:.4g}" for term, value in earned.items())
                for name, earned in terms.items()
            ),
        )
        if term_look
        else None,
        "term_look": term_look,
        "decision_times": Plot(
            figures.decision_times(episodes, look, None if period is None else 1e3 * period),
            "; ".join(
                f"{policy.policy}: median {policy.decision_ms_p50:.3g} ms, "
                f"99th percentile {policy.decision_ms_p99:.3g} ms"
                for policy in policies
            ),
        ),
        "learning": Plot(figures.learning(curves, policies, look), "Success during training") if curves else None,
        "curve_problems": problems,
    }


def _verdict(results: Results) -> str:
    policies = results.comparison.policies
    if results.comparison.paired:
        return verdict(policies, results.comparison.paired)
    if not policies:
        return "No episode was finished."
    only, success = policies[0], policies[0].success
    return f"{only.policy} succeeds in {_percent(success)} of {only.episodes} episodes ({_spread(success, 100)} %)."


def _paired(results: Results, look: style.Looks) -> list[Plot]:
    pairs = results.comparison.paired
    if len(pairs) > MOST_PAIRS:
        best = max(results.comparison.policies, key=lambda policy: policy.success.value if policy.success else 0.0)
        pairs = [pair for pair in pairs if best.policy in (pair.a, pair.b)]
    plots = []
    for pair in pairs:
        a, b = look[pair.a].label, look[pair.b].label
        difference = pair.return_difference
        plots.append(
            Plot(
                figures.paired(pair, results.episodes, look),
                f"Returns of {pair.a} against those of {pair.b}",
                f"{a} against {b}",
                f"Success {100 * (pair.only_a - pair.only_b) / pair.episodes:+.1f} % "
                f"({pair.only_a} won only by the first, {pair.only_b} only by the second; p = {pair.mcnemar_p:.2g}). "
                + style.signed(f"Return {difference.value:+.1f} ({_spread(difference, sign='+')})."),
            )
        )
    return plots


def _videos(results: Results, trusted: bool, progress: Callable[[str], None]) -> dict[str, Any]:
    """The clips, or why there are none."""
    if not results.episodes:
        return {"no_videos": "There is no episode to show."}
    progress("filming the same episode under each policy")
    together = film(results, apart, trusted) if (apart := most_different(results.episodes)) else []
    lowest = []
    for result in worst(results.episodes):
        progress(f"filming the worst episode of {result.policy}")
        lowest += film(results, [result], trusted)
    problems = {clip.problem for clip in (*together, *lowest)}
    no_videos = problems.pop() if len(problems) == 1 and not any(clip.video for clip in (*together, *lowest)) else ""
    return {
        "no_videos": no_videos,
        "together": together,
        "lowest": lowest,
        "view": lambda result: _view(results, result),
    }


def _view(results: Results, result: EpisodeResult) -> str:
    """The command that shows an episode."""
    return _command("view", results, f"--episode {result.episode}", names=[result.policy])


def _command(verb: str, results: Results, more: str, names: Sequence[str]) -> str:
    comparison = results.comparison
    options = [f"--set {shlex.quote(f'{name}={value}')}" for name, value in comparison.env_options.items()]
    words = ("armctl", verb, *map(shlex.quote, names), "--env", shlex.quote(comparison.env), *options)
    return " ".join((*words, f"--seed {comparison.seed}", more)).rstrip()


def _disturbances(sweep: pd.DataFrame) -> str:
    levels = sweep.groupby("disturbance", sort=False)["level"].unique()
    asked = [f"{name}={','.join(f'{level:g}' for level in at)}" for name, at in levels.items()]
    return "".join(f" --disturbance {shlex.quote(one)}" for one in asked)


def _period(results: Results, trusted: bool) -> float | None:
    """The control period, s; None if the environment cannot be made here."""
    if names_code(results.comparison.env) and not trusted:
        return None
    try:
        with closing(make_worlds(results.comparison.env, 1, results.comparison.env_options)) as worlds:
            return float(worlds.task.control_period)
    except ArmctlError:
        return None


def _robustness(sweep: pd.DataFrame, look: style.Looks) -> list[Plot]:
    return [
        Plot(figures.robustness(rows, look), f"Success against the level of {name}", str(name))
        for name, rows in sweep.groupby("disturbance", sort=False)
        if rows.level.nunique() > 1
    ]


def _percent(estimate: Estimate | None) -> str:
    return NOTHING if estimate is None else f"{100 * estimate.value:.1f} %"


def _mean(estimate: Estimate | None) -> str:
    return NOTHING if estimate is None else style.signed(f"{estimate.value:,.1f}")


def _spread(estimate: Estimate | None, scale: float = 1.0, sign: str = "") -> str:
    if estimate is None or estimate.low is None or estimate.high is None:
        return "interval unknown" if estimate else ""
    low, high = scale * estimate.low, scale * estimate.high
    return style.signed(f"{low:{sign}.1f} to {high:{sign}.1f}")


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode("ascii")

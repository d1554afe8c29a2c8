"""Writes the report of a results folder: one HTML file that makes no network requests."""

import os.path
import shlex
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

from armctl.core.errors import no_results
from armctl.core.registration import import_attribute, remember_named
from armctl.envs import full_id
from armctl.episodes.record import EpisodeResult
from armctl.episodes.stored import UNDISTURBED
from armctl.policies import is_code
from armctl.report import style
from armctl.report.pair_maps import pair_maps
from armctl.report.plots import comparison_plots, mean, percent, renamed, spread, sweep_plots
from armctl.report.render import write_page
from armctl.report.suite_page import write_suite_page
from armctl.runtime.provenance import with_looks
from armctl.stats.robustness import robustness_headline, robustness_rankings
from armctl.study.comparison import Comparison
from armctl.study.grid_tables import grid_summary
from armctl.study.names import FROM_UNDISTURBED, SUITE, WORST_CASE, task_name
from armctl.study.results import read_study
from armctl.study.study import Study
from armctl.study.task_results import Sweep
from armctl.verdict.sentences import Verdict
from armctl.verdict.summary import PolicySummary
from armctl.verdict.summary_tables import listed_files

REPORT = "report.html"


def write_report(
    folder: str | Path,
    out: str | Path | None = None,
    *,
    video: bool | None = None,
    env: str | None = None,
    policies: Sequence[str] = (),
    progress: Callable[[str], None] = lambda doing: None,
    study: Study | None = None,
) -> Path:
    """Write the report of a study's folder to `out` (`folder/report.html`); return its path.

    With `video`, some episodes are played again; if that is impossible, the report says why. By default, it is so but
    for suites, whose tasks get reports of their own. A folder runs no code:
    what it names as `module:name` is imported only if it is `env` or one of `policies`, or was named in this process
    before. `progress` is called with what is being done. The `study` is what was just played into the folder, which is
    read if it is None.

    Raises `ResultsError` for a folder without results, or with damaged ones, and if the report cannot be written.
    """
    if env is not None:
        remember_named(full_id(env))
    for name in filter(is_code, policies):
        import_attribute(name, "policy")
    folder = Path(folder)
    if not os.path.isdir(folder):  # also for a name that no folder can have
        raise no_results(folder)
    out, study = folder / REPORT if out is None else Path(out), study or read_study(folder)
    if study.kind == WORST_CASE:
        from armctl.report.worst_case_page import write_worst_case_page  # it loads what searches

        write_worst_case_page(folder, out, video, progress)
        return out
    reports: dict[str, str] = {}
    for env, swept in study.tasks.items():
        name, page = folder.resolve().name, out
        if study.kind == SUITE:
            name = task_name(env)
            progress(name)
            page = out.with_name(f"{name}.html")
            reports[env] = quote(page.name)
        write_task_page(swept, page, name, bool(video) if study.kind == SUITE else video, progress)
    if study.kind == SUITE:
        write_suite_page(study, folder, out, reports)
    return out


def write_task_page(swept: Sweep, out: Path, name: str, video: bool | None, progress: Callable[[str], None]) -> None:
    """Write the page of a task: its undisturbed comparison, and its disturbances if there are any."""
    comparison, points = swept.comparisons[UNDISTURBED], swept.points
    names = list(dict.fromkeys((*comparison.names, *points.policy)))
    styles, groups = style.styles_of(names), comparison.facts.groups
    styles |= {member: replace(styles[name], label=member) for name in groups for member in groups[name]}
    rankings = robustness_rankings(points, swept.pairs) if points.policy.nunique() > 1 else []
    page: dict[str, Any] = {
        "styles": styles,
        "folder": name,
        "comparison": comparison,
        "robustness": sweep_plots(points, rankings, styles) if len(points) else [],
        "ranking": renamed(with_looks(robustness_headline(rankings) or grid_summary(swept.maps), swept.looks), styles),
        "swept_by_success": bool(points.success.notna().any()),
        "swept": [styles[policy] for policy in points.policy.unique()],
        "together": [],
        "lowest": [],
    }
    progress("drawing figures")
    page |= _comparison(comparison, styles) | pair_maps(swept.maps, swept.units, styles)
    if len(points) or swept.maps:
        page["command"] = f"{_command('sweep', comparison, page['extent'])}{_disturbances(swept)}"
    if video is False:
        page["no_videos"] = (
            ""
            if swept.undisturbed and swept.undisturbed.facts.sources
            else "armctl report without --no-video films some episodes."
        )
    elif comparison.facts.real_time:
        page["no_videos"] = "Episodes in real time cannot be played again for them."
    else:
        page |= _videos(comparison, progress)
    progress("writing")
    write_page(out, "page.html.j2", page)


def _comparison(comparison: Comparison, styles: style.Styles) -> dict[str, Any]:
    """Everything on the page about a comparison, except for videos."""
    policies = comparison.policies
    planned = policies[0].planned if policies else 0
    is_repeatable = planned > 0 and not comparison.facts.sources
    extent = f"--episodes {planned}{_parallel(policies)}{_real_time_options(comparison)}" if is_repeatable else ""
    verdict = comparison.verdict or Verdict(_single(comparison))
    page: dict[str, Any] = {
        "headline": renamed(verdict.result, styles),
        "cost": renamed(verdict.cost, styles),
        "context": renamed(verdict.context, styles),
        "planned": planned,
        "extent": extent,
        "command": _command("compare", comparison, extent) if is_repeatable else "",
        "found_in": listed_files(comparison.facts.sources),
        "missing": [
            name
            for name in comparison.names
            if name not in comparison.counted and name not in comparison.facts.disqualified
        ],
    }
    return page | (comparison_plots(comparison, styles) if policies else {})


def _single(comparison: Comparison) -> str:
    """Return the headline without a pair of policies."""
    policies = comparison.policies
    if not policies:
        return "No episode was finished."
    only, success = policies[0], policies[0].success
    if success is None:
        return f"{only.policy} earns {mean(only.episode_return)} in the mean of {only.episodes} episodes."
    return f"{only.policy} succeeds in {percent(success)} of {only.episodes} episodes ({spread(success, 100)} %)."


def _videos(comparison: Comparison, progress: Callable[[str], None]) -> dict[str, Any]:
    """Return the clips, or why there are none."""
    from armctl.report.videos import film, largest_difference, lowest_returns  # with the simulator

    if not comparison.counted:
        return {"no_videos": "There is no episode to show."}
    apart = largest_difference(comparison.counted) if comparison.facts.paired else []
    if apart:
        progress("filming the same episode under each policy")
    together = film(comparison, apart) if apart else []
    lowest = []
    for result in lowest_returns(comparison.counted):
        progress(f"filming the worst episode of {result.policy}")
        lowest += film(comparison, [result])
    problems = {clip.problem for clip in (*together, *lowest)}
    no_videos = problems.pop() if len(problems) == 1 and not any(clip.video for clip in (*together, *lowest)) else ""
    return {
        "no_videos": no_videos,
        "together": together,
        "lowest": lowest,
        "view": lambda result: _view(comparison, result),
    }


def _view(comparison: Comparison, result: EpisodeResult) -> str:
    """Return the command that shows an episode."""
    if result.metrics.contacts is None:  # not made of a task: its window is its own
        return _command("run", comparison, f"--episode {result.episode} --watch", names=[result.policy])
    return _command("view", comparison, f"--episode {result.episode}", names=[result.policy])


def _command(verb: str, comparison: Comparison, more: str, names: Sequence[str] | None = None) -> str:
    options = [f"--set {shlex.quote(f'{name}={value}')}" for name, value in comparison.env_options.items()]
    words = (
        "armctl",
        verb,
        *map(shlex.quote, names or comparison.names),
        "--env",
        shlex.quote(comparison.env),
        *options,
    )
    return " ".join((*words, f"--seed {comparison.seed}", more)).rstrip()


def _parallel(policies: Sequence[PolicySummary]) -> str:
    """Return the options with which the decision times were taken like this."""
    used = {name: max(getattr(policy, name) for policy in policies) for name in ("worlds", "workers")}
    return "".join(f" --{name} {count}" for name, count in used.items() if count > 1)


def _real_time_options(comparison: Comparison) -> str:
    """Return the options of a world that does not wait."""
    real_time = comparison.facts.real_time
    if real_time is None:
        return ""
    return f" --real-time {shlex.quote(str(real_time['latency']))} --slow-down {real_time['slow_down']:g}"


def _disturbances(swept: Sweep) -> str:
    settings = [f"{name}={','.join(f'{level:g}' for level in at)}" for name, at in swept.levels.items()]
    recorded = "" if swept.recorded in ("", FROM_UNDISTURBED) else f" --real-time {shlex.quote(swept.recorded)}"
    pairs = [
        ",".join(
            f"{name}={','.join(f'{level:g}' for level in at[1:])}"
            for name, at in ((grid.rows, grid.row_levels), (grid.columns, grid.column_levels))
        )
        for grid in swept.grids
    ]
    options = [("disturbance", setting) for setting in settings] + [("pairs", pair) for pair in pairs]
    return "".join(f" --{name} {shlex.quote(value)}" for name, value in options) + recorded

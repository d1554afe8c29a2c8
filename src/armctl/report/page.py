"""Writes the report of a results folder: one HTML file that makes no network requests."""

import os.path
import shlex
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pandas as pd

from armctl.core.errors import ResultsError
from armctl.core.files import inside
from armctl.core.registration import import_attribute, remember_named
from armctl.envs import full_id
from armctl.episodes.record import EpisodeResult
from armctl.episodes.store import STORE
from armctl.report import style
from armctl.report.plots import comparison_plots, mean, percent, renamed, spread, sweep_plots
from armctl.report.render import write_page
from armctl.report.suite_page import task_folders, write_suite_page
from armctl.report.videos import film, most_different, worst
from armctl.runtime.provenance import with_looks
from armctl.stats.robustness import robustness_headline, robustness_rankings
from armctl.study.curves import LOOKS, POINTS, RECORDED, read_pairs, read_sweep
from armctl.study.results import Results, read_results
from armctl.study.suite import SUITE
from armctl.study.suite_results import read_suite
from armctl.study.sweep import UNDISTURBED
from armctl.verdict.summary import PolicySummary

REPORT = "report.html"


def write_report(
    folder: str | Path,
    out: str | Path | None = None,
    *,
    video: bool | None = None,
    env: str | None = None,
    policies: Sequence[str] = (),
    progress: Callable[[str], None] = lambda doing: None,
) -> Path:
    """Write the report of a comparison's, sweep's or suite's folder to `out` (`folder/report.html`); return its path.

    With `video`, some episodes are played again; if that is impossible, the report says why. By default, it is so but
    for suites, whose tasks get reports of their own. A folder runs no code:
    what it names as `module:name` is imported only if it is `env` or one of `policies`, or was named in this process
    before. `progress` is called with what is being done.

    Raises `ResultsError` for a folder without results, or with damaged ones, and if the report cannot be written.
    """
    if env is not None:
        remember_named(full_id(env))
    for name in filter(lambda policy: ":" in policy, policies):
        import_attribute(name, "policy")
    folder = Path(folder)
    if not os.path.isdir(folder):  # also for a name that no folder can have
        raise ResultsError(f"there is no folder {folder}: armctl compare --out {shlex.quote(str(folder))} makes one")
    out = folder / REPORT if out is None else Path(out)
    if (folder / SUITE).exists():
        return _suite(folder, out, bool(video), progress)
    sweep = read_sweep(folder) if (folder / POINTS).exists() else None
    home = folder if sweep is None or (folder / STORE).exists() else folder / UNDISTURBED
    if sweep is None and not (home / STORE).exists():
        raise ResultsError(f"{folder} holds no results: armctl compare --out {folder} writes some")
    results = read_results(home) if (home / STORE).exists() else None
    names = list(results.names) if results else []
    if sweep is not None:
        names += [name for name in sweep.policy.unique() if name not in names]
    styles = style.styles_of(names)
    groups = results.comparison.groups if results else {}
    styles |= {member: replace(styles[name], label=member) for name in groups for member in groups[name]}
    several = sweep is not None and sweep.policy.nunique() > 1
    looks = [] if sweep is None else sweep.attrs[LOOKS]
    rankings = robustness_rankings(sweep, read_pairs(folder)) if sweep is not None and several else []
    page: dict[str, Any] = {
        "styles": styles,
        "folder": folder.resolve().name,
        "robustness": [] if sweep is None else sweep_plots(sweep, rankings, styles),
        "ranking": renamed(with_looks(robustness_headline(rankings), looks), styles),
        "swept_by_success": sweep is not None and bool(sweep.success.notna().any()),
        "swept": [] if sweep is None else [styles[name] for name in sweep.policy.unique()],
        "results": results,
        "together": [],
        "lowest": [],
    }
    if results is not None:
        progress("drawing figures")
        page |= _comparison(results, styles)
        if sweep is not None:
            page["command"] = f"{_command('sweep', results, page['extent'], results.names)}{_disturbances(sweep)}"
        if video is False:
            page["no_videos"] = "They were left out (--no-video)."
        elif results.comparison.real_time:
            page["no_videos"] = "Episodes in real time cannot be played again for them."
        else:
            page |= _videos(results, progress)
    progress("writing")
    write_page(out, "page.html.j2", page)
    return out


def _suite(folder: Path, out: Path, video: bool, progress: Callable[[str], None]) -> Path:
    """Write the page of a suite, and beside it, the reports of its tasks."""
    suite, reports = read_suite(folder), dict[str, str]()
    for env, name in task_folders(suite).items():
        home = inside(folder, name)
        if not suite.tasks[env].levels:  # it knows no disturbance
            home = inside(home, UNDISTURBED)
        if UNDISTURBED in suite.tasks[env].comparisons:
            progress(name)
            write_report(home, video=video)
            reports[env] = quote(Path(os.path.relpath(home / REPORT, out.parent)).as_posix())
    write_suite_page(suite, folder, out, reports)
    return out


def _comparison(results: Results, styles: style.Styles) -> dict[str, Any]:
    """Everything on the page about a comparison, except for videos."""
    comparison, episodes = results.comparison, results.episodes
    policies = comparison.policies
    planned = policies[0].planned if policies else 0
    extent = f"--episodes {planned}{_parallel(policies)}{_real_time_options(results)}" if planned else ""
    result, cost = comparison.headline
    page: dict[str, Any] = {
        "headline": renamed(result or _single(results), styles),
        "cost": renamed(cost, styles),
        "verdict": renamed(comparison.verdict, styles),
        "planned": planned,
        "extent": extent,
        "command": _command("compare", results, extent, results.names),
        "missing": [name for name in results.names if name not in episodes and name not in comparison.disqualified],
    }
    return page | (comparison_plots(results, styles) if policies else {})


def _single(results: Results) -> str:
    """Return the headline without a pair of policies."""
    policies = results.comparison.policies
    if not policies:
        return "No episode was finished."
    only, success = policies[0], policies[0].success
    if success is None:
        return f"{only.policy} earns {mean(only.episode_return)} in the mean of {only.episodes} episodes."
    return f"{only.policy} succeeds in {percent(success)} of {only.episodes} episodes ({spread(success, 100)} %)."


def _videos(results: Results, progress: Callable[[str], None]) -> dict[str, Any]:
    """Return the clips, or why there are none."""
    if not results.episodes:
        return {"no_videos": "There is no episode to show."}
    progress("filming the same episode under each policy")
    together = film(results, apart) if (apart := most_different(results.episodes)) else []
    lowest = []
    for result in worst(results.episodes):
        progress(f"filming the worst episode of {result.policy}")
        lowest += film(results, [result])
    problems = {clip.problem for clip in (*together, *lowest)}
    no_videos = problems.pop() if len(problems) == 1 and not any(clip.video for clip in (*together, *lowest)) else ""
    return {
        "no_videos": no_videos,
        "together": together,
        "lowest": lowest,
        "view": lambda result: _view(results, result),
    }


def _view(results: Results, result: EpisodeResult) -> str:
    """Return the command that shows an episode."""
    if result.metrics.contacts is None:  # not made of a task: its window is its own
        return _command("run", results, f"--episode {result.episode} --watch", names=[result.policy])
    return _command("view", results, f"--episode {result.episode}", names=[result.policy])


def _command(verb: str, results: Results, more: str, names: Sequence[str]) -> str:
    comparison = results.comparison
    options = [f"--set {shlex.quote(f'{name}={value}')}" for name, value in comparison.env_options.items()]
    words = ("armctl", verb, *map(shlex.quote, names), "--env", shlex.quote(comparison.env), *options)
    return " ".join((*words, f"--seed {comparison.seed}", more)).rstrip()


def _parallel(policies: Sequence[PolicySummary]) -> str:
    """Return the options with which the decision times were taken like this."""
    used = {name: max(getattr(policy, name) for policy in policies) for name in ("worlds", "workers")}
    return "".join(f" --{name} {count}" for name, count in used.items() if count > 1)


def _real_time_options(results: Results) -> str:
    """Return the options of a world that does not wait."""
    real_time = results.comparison.real_time
    if real_time is None:
        return ""
    return f" --real-time {shlex.quote(str(real_time['latency']))} --slow-down {real_time['slow_down']:g}"


def _disturbances(sweep: pd.DataFrame) -> str:
    levels = sweep.groupby("disturbance", sort=False)["level"].unique()
    settings = [f"{name}={','.join(f'{level:g}' for level in at)}" for name, at in levels.items()]
    recorded = sweep.attrs.get(RECORDED)
    real_time_option = f" --real-time {shlex.quote(str(recorded))}" if recorded else ""
    return "".join(f" --disturbance {shlex.quote(setting)}" for setting in settings) + real_time_option

"""The page of worst cases: the mildest failure of each policy, and a video of one."""

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

from armctl.core.errors import os_errors_as
from armctl.core.files import write_atomically
from armctl.core.registration import bare_id
from armctl.report.render import write_page
from armctl.stats.robustness import listed
from armctl.study.mildest_failure import read_worst_cases
from armctl.study.worst_case_results import Case, WorstCases


def write_worst_case_page(folder: Path, out: Path, video: bool | None, progress: Callable[[str], None]) -> None:
    """Write the page of a search in `folder`, and the videos of failures as `failure-N.mp4` beside it.

    Raises `ResultsError` if the folder is damaged, or the page cannot be written.
    """
    result = read_worst_cases(folder)
    page: dict[str, Any] = {
        "result": result,
        "headline": headline(result),
        "rows": [_row(result, case, i, out, video is not False, progress) for i, case in enumerate(result.cases)],
        "command": _command(result),
        "folder": folder.resolve().name,
    }
    progress("writing")
    write_page(out, "worst_case.html.j2", page)


def headline(result: WorstCases) -> str:
    """Return the distance at which each policy fails, in a sentence."""
    parts = [f"{case.policy} at {case.distance_in_words} [{case.interval_in_words}]" for case in result.cases]
    return f"Distance of the mildest failure in {bare_id(result.env)}: {listed(parts) or 'no policy has finished'}"


def _row(
    result: WorstCases, case: Case, number: int, out: Path, video: bool, progress: Callable[[str], None]
) -> dict[str, Any]:
    """Return what the page shows of a policy, with a video of its failure."""
    clip = None
    if video and case.failure is not None:
        from armctl.report.videos import film  # with the simulator

        progress(f"filming a failure of {case.policy}")
        (clip,) = film(case.comparison, [case.failure])
        if clip.video:
            path = out.with_name(f"failure-{number + 1}.mp4")
            with os_errors_as(f"the video {path} cannot be written"):
                write_atomically(path, clip.video)
    return {
        "case": case,
        "shares": [100 * axis.share(case.levels.get(axis.name, axis.neutral)) for axis in result.axes],
        "clip": clip,
    }


def _command(result: WorstCases) -> str:
    comparison = result.cases[0].comparison if result.cases else None
    if comparison is None:
        return ""
    names = {axis.name for axis in result.axes}
    options = dict(comparison.env_options)
    constant = {name: level for name, level in options.pop("disturbances", {}).items() if name not in names}
    options |= {"disturbances": constant} if constant else {}
    words = [
        "armctl worst-case", *(shlex.quote(case.policy) for case in result.cases), "--env", shlex.quote(result.env),
        *(f"--set {shlex.quote(f'{name}={value}')}" for name, value in options.items()),
        "--disturbances", ",".join(f"{axis.name}={axis.end:g}" for axis in result.axes),
        f"--budget {result.budget} --episodes {result.cases[0].summary.planned}",
        f"--seed {result.seeds[0]} --judge-seed {result.judge_seed}",
    ]  # fmt: skip
    return " ".join(words)

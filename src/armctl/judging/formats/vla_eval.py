"""vla-eval's result files (allenai/vla-evaluation-harness).

Source: `src/vla_eval/results/collector.py`. A file has `benchmark`, `harness_version` and `tasks`, a list of `task` and
`episodes`; an episode has `episode_id`, `metrics` (such as `success`), `steps`, and a `failure_reason` if the harness
failed, which vla-eval leaves out of its rates. The file does not name the policy.
"""

from typing import Any

from armctl.judging.rows import Rows, rows_of_records


def rows(source: str, document: Any) -> list[Rows] | None:
    """Return the episodes of each task; None for a file of another format."""
    if not isinstance(document, dict) or "harness_version" not in document or "tasks" not in document:
        return None
    parts = []
    for task in document["tasks"]:
        failed = [episode for episode in task["episodes"] if episode.get("failure_reason")]
        records = [
            {"episode": episode["episode_id"], "steps": episode.get("steps"), **episode["metrics"]}
            for episode in task["episodes"]
            if not episode.get("failure_reason")
        ]
        reasons = sorted({str(episode["failure_reason"]) for episode in failed})
        note = f"{len(failed)} episodes of {task['task']} that the harness lost are left out, as vla-eval does"
        notes = [f"{note}: {', '.join(reasons)}."] if failed else []
        only = {} if len(document["tasks"]) == 1 else {"task": task["task"]}
        about = {"is_known_format": True, "notes": notes, "constants": {**only, "kind": "learned"}}
        parts.append(rows_of_records(source, records, "episode", **about))
    return parts

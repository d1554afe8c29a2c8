"""robo-evals' `report.json` (superintelligenceco/robo-evals).

Source: `src/robo_evals/report.py` and `runner.py`, schema `robo-evals/report/1`: `policy`, `config` with `max_steps`,
and `tasks`, a list of `task` and `episode_results`, each with `episode`, `seed`, `success` and `steps`.
"""

from typing import Any

from armctl.judging.rows import Rows, rows_of_records

SCHEMA = "robo-evals/report/"


def rows(source: str, document: Any) -> list[Rows] | None:
    """Return the episodes of each task; None for a file of another format."""
    if not isinstance(document, dict) or not str(document.get("schema", "")).startswith(SCHEMA):
        return None
    limit = document["config"].get("max_steps")
    return [
        rows_of_records(
            source,
            [
                {name: episode[name] for name in ("episode", "seed", "success", "steps")}
                for episode in task["episode_results"]
            ],
            "episode",
            is_known_format=True,
            time_limit=limit,
            constants={"policy": document["policy"], **({"task": task["task"]} if len(document["tasks"]) > 1 else {})},
        )
        for task in document["tasks"]
    ]

"""LeRobot's `eval_info.json`, which `lerobot-eval` writes.

Source: `src/lerobot/scripts/lerobot_eval.py` of huggingface/lerobot. Until 2025 it had `per_episode`, a list of
`episode_ix`, `sum_reward`, `max_reward`, `success` and `seed`, beside `aggregated`; since then `per_task`, a list of
`task_group`, `task_id` and `metrics` with the lists `sum_rewards`, `max_rewards` and `successes`, one value for each
episode in the order of their seeds, which begin with that of the evaluation. The file does not name the policy.
"""

from typing import Any

from armctl.judging.rows import Rows, rows_of_records

NOTE = (
    "the seed is not in the file; equal numbers are equal episodes if the evaluations had the same --seed and --env; "
    "if they had not, say --unpaired."
)


def rows(source: str, document: Any) -> list[Rows] | None:
    """Return the episodes of each task; None for a file of another format."""
    if not isinstance(document, dict):
        return None
    if "aggregated" in document and isinstance(document.get("per_episode"), list):
        names = {"episode_ix": "episode", "sum_reward": "return", "success": "success", "seed": "seed"}
        records = [
            {names[key]: episode[key] for key in names if episode.get(key) is not None}
            for episode in document["per_episode"]
        ]
        return [rows_of_records(source, records, "episode", is_known_format=True, constants={"kind": "learned"})]
    if not isinstance(document.get("per_task"), list) or "overall" not in document:
        return None
    parts = []
    for task in document["per_task"]:
        metrics, name = task["metrics"], f"{task['task_group']} {task['task_id']}"
        columns = zip(metrics["successes"], metrics["sum_rewards"], strict=True)
        records = [{"episode": i, "success": won, "return": reward} for i, (won, reward) in enumerate(columns)]
        only = {} if len(document["per_task"]) == 1 else {"task": name}
        about = {"is_known_format": True, "constants": {**only, "kind": "learned"}, "notes": [NOTE]}
        parts.append(rows_of_records(source, records, "episode", **about))
    return parts

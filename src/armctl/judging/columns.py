"""Fields of columns: by the names that people and libraries give them, or as the caller says."""

import re
from collections.abc import Mapping, Sequence

from armctl.core.errors import ConfigurationError, nearest
from armctl.judging.rows import Rows

FIELDS: Mapping[str, tuple[str, ...]] = {
    "policy": ("policy", "method", "algorithm", "algo", "agent", "model", "controller", "planner", "approach",
               "policy_name", "policy_id", "model_name", "checkpoint", "variant", "system"),
    "task": ("task", "task_name", "task_id", "env", "env_id", "env_name", "environment", "benchmark", "scene"),
    "condition": ("condition", "conditions", "setting", "perturbation", "disturbance", "cell", "variation"),
    "training_seed": ("training_seed", "train_seed", "model_seed", "training_run", "train_run"),
    "seed": ("seed", "episode_seed", "env_seed", "eval_seed", "initial_condition", "initial_state", "init_state",
             "init", "start", "start_pose", "start_position", "initial_pose", "layout",
             "configuration"),
    "episode": ("episode", "episode_id", "episode_ix", "episode_index", "episode_idx", "episode_num", "trial",
                "trial_id", "trial_no", "trial_number", "rollout", "rollout_id", "rollout_idx", "attempt", "ep"),
    "success": ("success", "is_success", "succeeded", "successful", "solved", "ok", "passed", "task_success", "won",
                "result", "outcome"),
    "return": ("return", "episode_return", "total_reward", "sum_reward", "episode_reward", "cumulative_reward",
               "reward", "score", "returns", "ret"),
    "time": ("time", "time_s", "seconds", "duration", "duration_s", "completion_time", "completion_time_s",
             "time_to_success", "execution_time", "episode_time", "elapsed", "time_sec", "time_in_s"),
    "steps": ("steps", "num_steps", "n_steps", "length", "episode_length", "ep_length", "ep_len", "timesteps"),
    "decision_ms": ("decision_ms", "decision_ms_p50", "decision_time_ms", "latency_ms", "inference_ms",
                    "inference_time_ms"),
    "feasible": ("feasible",),
    "training_steps": ("training_steps", "train_steps", "total_timesteps"),
}  # fmt: skip
"""Names of a field's column, in the order of preference; capitals, spaces and units in brackets do not matter."""
SCORES = ("success", "return", "time")
"""Fields of which a file needs at least one."""


def columns_of(rows: Rows, chosen: Mapping[str, str]) -> dict[str, int]:
    """Return the place of each field's column that there is; `chosen` are the headings that were said, by field.

    Raises `ConfigurationError` for a chosen heading that is missing, and where several columns may be meant.
    """
    headings = [plain(heading) for heading in rows.headings]
    twice = sorted({rows.headings[i] for i, name in enumerate(headings) if name and headings.index(name) < i})
    columns = {}
    for field, names in FIELDS.items():
        if field in chosen:
            columns[field] = _place(rows, headings, chosen[field], field)
            continue
        if rows.is_known_format:
            names = (field,)
        elif field == "success" and "success" not in headings and "is_success" not in headings:
            names = (*names, "label")
        places = [headings.index(name) for name in names if name in headings]
        if len(places) > 1 and headings[places[0]] != field:
            several = " and ".join(repr(rows.headings[place]) for place in places)
            raise ConfigurationError(
                f"{rows.source}: {several} may be the {field.replace('_', ' ')}: say which, --{_option(field)} "
                f"{rows.headings[places[0]]}"
            )
        if places:
            columns[field] = places[0]
    if clash := [name for name in twice if headings.index(plain(name)) in columns.values()]:
        raise ConfigurationError(f"{rows.source}: two columns are called {clash[0]!r}, and either may be meant")
    return columns


def require(rows: Rows, columns: Mapping[str, int]) -> None:
    """Raise `ConfigurationError` unless there is a column of success, return or time."""
    if set(SCORES).isdisjoint(columns):
        listed = ", ".join(map(repr, rows.headings[:12])) or "none"
        if rates := [name for name in rows.headings if "rate" in plain(name) or "%" in name]:
            raise ConfigurationError(
                f"{rows.source}: {rates[0]!r} is a rate, and says nothing without the number of episodes: a row is "
                "needed for each episode, or the counts, such as 17/20, in a column success"
            )
        raise ConfigurationError(
            f"{rows.source} has no column of success, return or time, under any usual name: say which it is, as in "
            "--success-column NAME, or --policies-in-columns if each policy has a column of successes. Its columns are "
            f"{listed}"
        )


def used_in_words(rows: Rows, columns: Mapping[str, int]) -> str:
    """Return which columns were taken for which field, where their names differ, and which were not used."""
    renamed = [
        f"{field.replace('_', ' ')} from {rows.headings[place]!r}"
        for field, place in columns.items()
        if plain(rows.headings[place]) != field
    ]
    unused = [repr(name) for i, name in enumerate(rows.headings) if name and i not in columns.values()]
    parts = [f"read {', '.join(renamed)}"] * bool(renamed) + [f"not used: {', '.join(unused[:8])}"] * bool(unused)
    return "; ".join(parts)


def _option(field: str) -> str:
    return f"{field.replace('_', '-')}-column"


def _place(rows: Rows, headings: Sequence[str], name: str, field: str) -> int:
    if name in rows.headings:
        return rows.headings.index(name)
    if plain(name) in headings:
        return headings.index(plain(name))
    listed = ", ".join(map(repr, rows.headings))
    raise ConfigurationError(
        f"{rows.source} has no column {name!r} for the {field.replace('_', ' ')}."
        f"{nearest(name, rows.headings)} There are: {listed}"
    )


def plain(heading: str) -> str:
    """Return a heading as `FIELDS` has it: in lower case, with underscores, without a unit in brackets."""
    without_unit = re.sub(r"[(\[].*?[)\]]", "", heading) if not heading.startswith(("(", "[")) else heading
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", without_unit)
    return re.sub(r"[^\w]+", "_", words.strip().lower()).strip("_")

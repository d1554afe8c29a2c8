"""Stable-Baselines3: `evaluations.npz` of its `EvalCallback`, and CSV files of its `Monitor`.

The arrays of an evaluation are `timesteps` (evaluations,), and `results`, `ep_lengths` and, if the environment says
it, `successes` (evaluations, episodes): `stable_baselines3/common/callbacks.py`, 2.9. A Monitor's file has a comment
with `t_start` and `env_id`, and columns `r` (return), `l` (length) and `t` (seconds since `t_start`, which is no time
of an episode): `stable_baselines3/common/monitor.py`. rl-zoo lays both out as `ALGO/ENV_N/`.
"""

import re
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from armctl.core.errors import ConfigurationError
from armctl.core.files import opened_regular
from armctl.judging.rows import Rows

LARGEST = 256 * 2**20
"""Bytes of a file."""
ALGORITHMS = {"a2c", "ars", "crossq", "ddpg", "dqn", "her", "ppo", "ppo_lstm", "qrdqn", "sac", "td3", "tqc", "trpo"}
"""Folders of rl-zoo's logs."""
RUN = re.compile(r"(?P<env>.+)_(?P<run>\d{1,9})")
ARRAYS = {"results": "return", "ep_lengths": "steps", "successes": "success"}


def read(path: Path) -> list[Rows]:
    """Read the last evaluation of a training. Raises `ConfigurationError`, `OSError` or `ValueError`."""
    source = str(path)
    with opened_regular(path, LARGEST) as file:
        try:
            with np.load(file, allow_pickle=False) as arrays:
                content = {name: arrays[name] for name in ("timesteps", *ARRAYS) if name in arrays}
        except (zipfile.BadZipFile, EOFError, KeyError, TypeError) as error:
            raise ValueError(f"it is damaged ({error})") from error
    shapes = {name: array.shape for name, array in content.items()}
    expected = shapes.get("results", ())
    if "timesteps" not in content or len(expected) != 2 or 0 in expected or shapes["timesteps"] != expected[:1]:
        raise ConfigurationError(
            f"{source} has no evaluations: Stable-Baselines3's EvalCallback writes timesteps and results, "
            f"not {', '.join(f'{name} {shape}' for name, shape in shapes.items()) or 'this'}"
        )
    names = [name for name in ARRAYS if shapes.get(name) == expected]
    values = np.stack([content[name][-1].astype(float) for name in names], axis=1).tolist()
    steps = int(content["timesteps"][-1])
    note = f"the last of {expected[0]} evaluations, after {steps:,} steps of training."
    rows = Rows(
        source=source, headings=[ARRAYS[name] for name in names], values=values, places=range(1, len(values) + 1),
        unit="episode", is_known_format=True, notes=[note], constants={"training_steps": steps, "kind": "learned"},
    )  # fmt: skip
    return [in_rl_zoo(path, rows)]


def monitor(path: Path, rows: Rows, header: dict[str, Any]) -> Rows:
    """Return the rows of a Monitor's file by the names of fields."""
    names = {"r": "return", "l": "steps", "is_success": "success"}
    headings = [names.get(heading, heading) for heading in rows.headings]
    env = header.get("env_id")
    note = "all episodes count alike; those of a training would be of a policy that changed."
    task = {} if env in (None, "None") else {"task": env}
    return in_rl_zoo(
        path, replace(rows, headings=headings, is_known_format=True, notes=[*rows.notes, note], constants=task)
    )


def in_rl_zoo(path: Path, rows: Rows) -> Rows:
    """Add algorithm, environment and run of a file in a folder `ALGO/ENV_N/`, as rl-zoo names them."""
    folder = path.absolute().parent
    run, algorithm = RUN.fullmatch(folder.name), folder.parent.name
    if run is None or not (algorithm in ALGORITHMS or (folder / run["env"]).is_dir()):
        return rows
    names = {"policy": algorithm, "task": run["env"], "training_seed": run["run"]}
    return replace(rows, constants={**rows.constants, **names})

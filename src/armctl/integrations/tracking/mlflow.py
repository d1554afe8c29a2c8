"""Trainings in MLflow: on the server that MLFLOW_TRACKING_URI names, or else in `mlflow.db` and `mlruns/` right here.

MLFLOW_EXPERIMENT_NAME says which experiment a run belongs to.
"""

import logging
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from armctl.core.errors import missing_extra
from armctl.integrations.tracking.tracker import PROJECT, Ending, Tracker

try:
    import alembic  # noqa: F401  # MLflow asks for it only when it makes a database
    import mlflow
    import sqlalchemy  # noqa: F401
    from mlflow.entities import Param
except ModuleNotFoundError as error:
    raise missing_extra("tracking by mlflow", error, "mlflow") from error

STATUS: dict[Ending, str] = {"finished": "FINISHED", "interrupted": "KILLED", "failed": "FAILED"}
LONGEST = 6000
"""Characters of a parameter that MLflow takes."""


class MlflowTracker(Tracker):
    """A run of MLflow, in the experiment `armctl` unless its variables name another."""

    def __init__(self, name: str, folder: Path, config: Mapping[str, Any], run: str | None) -> None:
        for noisy in ("mlflow", "alembic"):  # which report every step of making a database
            logging.getLogger(noisy).setLevel(logging.WARNING)
        self._client = mlflow.MlflowClient()
        if run is None:
            title = os.environ.get("MLFLOW_EXPERIMENT_NAME", PROJECT)
            experiment = self._client.get_experiment_by_name(title)
            number = experiment.experiment_id if experiment else self._client.create_experiment(title)
            self.run = self._client.create_run(number, run_name=name).info.run_id
            self._client.log_batch(self.run, params=[Param(key, str(v)[:LONGEST]) for key, v in _flat(config)])
        else:  # parameters of a run stay as they are
            self.run = run
            self._client.update_run(run, "RUNNING")
        self.where = f"run {self.run} of {mlflow.get_tracking_uri()}"

    def log(self, steps: int, values: Mapping[str, float]) -> None:  # noqa: D102
        for name, value in values.items():
            self._client.log_metric(self.run, name, value, step=steps)

    def agent(self, files: Sequence[Path]) -> None:  # noqa: D102
        for file in files:
            self._client.log_artifact(self.run, str(file), "agent")

    def video(self, file: Path, steps: int) -> None:  # noqa: D102
        self._client.log_artifact(self.run, str(file), "video")

    def finish(self, ending: Ending) -> None:  # noqa: D102
        self._client.set_terminated(self.run, STATUS[ending])


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Nested values by dotted names, such as `options.gamma`."""
    for name, value in values.items():
        if isinstance(value, Mapping) and value:
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value

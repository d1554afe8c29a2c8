"""Trainings in Weights & Biases: online, or offline (`WANDB_MODE=offline`), for `wandb sync` to upload later.

WANDB_PROJECT, WANDB_ENTITY and its other variables say where a run goes. Who is not logged in, or has no network,
gets an offline run.
"""

import os
import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from armctl.core.errors import missing_extra
from armctl.integrations.tracking.tracker import PROJECT, Ending, Tracker

try:
    import wandb
except ModuleNotFoundError as error:
    raise missing_extra("tracking by wandb", error, "wandb") from error

EXIT_CODES: dict[Ending, int] = {"finished": 0, "interrupted": 255, "failed": 1}
"""Exit codes of finished, killed and failed runs."""
PATIENCE = 45
"""s to wait for the upload of a finished run."""
NOT_IN_NAMES = re.compile(r"[^\w.-]")
"""Characters that an artifact's name must not have."""


class WandbTracker(Tracker):
    """A run of Weights & Biases, whose x axis is the training's steps."""

    def __init__(self, name: str, folder: Path, config: Mapping[str, Any], run: str | None) -> None:
        def begin(mode: Literal["offline"] | None) -> wandb.Run:
            return wandb.init(
                project=os.environ.get("WANDB_PROJECT", PROJECT),
                name=name,
                id=run,
                resume="allow",
                dir=folder,
                config=dict(config),
                mode=mode,
                reinit="create_new",  # a learner may have a run of its own
                settings=wandb.Settings(console="off", silent=True, finish_timeout=PATIENCE),
            )

        has_account = "WANDB_MODE" in os.environ or wandb.login(prompt=False, verify=False)
        try:
            self._run = begin(None if has_account else "offline")
        except wandb.errors.CommError:
            self._run = begin("offline")
        self._run.define_metric("*", step_metric="steps")
        self.run = self._run.id
        upload = f"wandb sync {shlex.quote(str(Path(self._run.dir).parent))}"
        self.where = upload if self._run.offline else str(self._run.url)

    def log(self, steps: int, values: Mapping[str, float]) -> None:  # noqa: D102
        self._run.log({"steps": steps, **values})

    def agent(self, files: Sequence[Path]) -> None:  # noqa: D102
        artifact = wandb.Artifact(NOT_IN_NAMES.sub("-", f"agent-{self.run}"), "model")
        for file in files:
            artifact.add_file(str(file))
        self._run.log_artifact(artifact)

    def video(self, file: Path, steps: int) -> None:  # noqa: D102
        self._run.log({"steps": steps, "video": wandb.Video(str(file), format="mp4")})

    def finish(self, ending: Ending) -> None:  # noqa: D102
        self._run.finish(EXIT_CODES[ending])

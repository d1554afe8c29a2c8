"""A short video of an agent, in the first of the episodes that it was selected by."""

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from armctl.core.seeds import VALIDATION_SEED
from armctl.viewer.recording import recording
from armctl.viewer.stage import Stage

EPISODES = 3
LONGEST = 20.0
"""s of the video."""


def film_agent(agent: Path, env: str, env_options: Mapping[str, Any], video: Path) -> None:
    """Film at most `EPISODES` episodes of the agent with that card, and at most `LONGEST` seconds.

    Raises `ArmctlError`, and whatever MuJoCo raises on a machine where it cannot render.
    """
    with contextlib.closing(Stage(str(agent), env, VALIDATION_SEED, 0, env_options, "rgb_array")) as stage:
        fps = stage.worlds.metadata["render_fps"]
        with recording(video, fps, lambda frames: None) as film:
            remaining = round(LONGEST * fps)
            for episode in range(EPISODES):
                stage.play(str(agent), VALIDATION_SEED, episode)
                while remaining > 0 and stage.status.outcome is None:
                    film(stage.worlds.render()[0])
                    stage.step()
                    remaining -= 1

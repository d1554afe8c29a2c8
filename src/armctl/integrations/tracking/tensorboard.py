"""Trainings in TensorBoard, in the training's own folder: `tensorboard --logdir FOLDER` shows them.

armctl's learners write their curve and the algorithm's own values there anyway. This adds options, agent's card and
video, and serves learners that write nothing.
"""

import io
import json
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import imageio
from PIL import Image

from armctl.core.errors import missing_extra
from armctl.integrations.tracking.tracker import Ending, Tracker

try:
    from tensorboard.compat.proto.summary_pb2 import Summary
    from torch.utils.tensorboard import SummaryWriter
except ModuleNotFoundError as error:
    raise missing_extra("tracking by tensorboard", error) from error

WIDTH, FRAME_RATE = 320, 10
"""Pixels and frames per second of a video, which TensorBoard takes as a GIF only: larger ones take megabytes."""


class TensorboardTracker(Tracker):
    """Event files in the folder of the training."""

    def __init__(self, name: str, folder: Path, config: Mapping[str, Any], run: str | None) -> None:
        events = folder / "tensorboard"
        self._writer = SummaryWriter(str(events))
        self.run, self.where = name, f"tensorboard --logdir {shlex.quote(str(events))}"
        if run is None:
            self._text("config", json.dumps(config, indent=2))

    def log(self, steps: int, values: Mapping[str, float]) -> None:  # noqa: D102
        for name, value in values.items():
            self._writer.add_scalar(f"held-out/{name}", value, steps)
        self._writer.flush()  # to be seen during the training

    def agent(self, files: Sequence[Path]) -> None:  # noqa: D102
        for file in files:
            if file.suffix == ".json":
                self._text("agent", file.read_text())

    def video(self, file: Path, steps: int) -> None:  # noqa: D102
        gif, width, height = _gif(file)
        picture = Summary.Image(width=width, height=height, colorspace=3, encoded_image_string=gif)
        self._writer._get_file_writer().add_summary(Summary(value=[Summary.Value(tag="video", image=picture)]), steps)

    def finish(self, ending: Ending) -> None:  # noqa: D102
        self._text("ended", ending)
        self._writer.close()

    def _text(self, title: str, text: str) -> None:
        self._writer.add_text(title, f"```\n{text}\n```")


def _gif(video: Path) -> tuple[bytes, int, int]:
    """Return a video as an animated GIF, with its width and height."""
    with imageio.get_reader(video) as reader:
        every = max(1, round(reader.get_meta_data()["fps"] / FRAME_RATE))
        frames = [Image.fromarray(frame) for i, frame in enumerate(reader) if i % every == 0]
    size = (WIDTH, round(WIDTH * frames[0].height / frames[0].width))
    first, *others = [frame.resize(size) for frame in frames]
    gif = io.BytesIO()
    first.save(gif, "GIF", save_all=True, append_images=others, duration=1000 // FRAME_RATE, loop=0)
    return gif.getvalue(), *size

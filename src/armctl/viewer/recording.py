"""Videos that are written whole or not at all. ffmpeg writes them, and does not say when a disk is full."""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import imageio
import numpy as np
from numpy.typing import NDArray

from armctl.core.errors import ConfigurationError, ResultsError, os_errors_as
from armctl.core.files import write_atomically
from armctl.datasets.pictures import count_frames

Film = Callable[[NDArray[np.uint8]], None]
VIDEO_FORMATS = (".mp4", ".mkv", ".mov", ".avi")
"""Containers that hold H.264, which every player knows."""


@contextmanager
def recording(video: Path, fps: int, written: Callable[[int], object]) -> Iterator[Film]:
    """Yield a function that appends frames to a video, which is whole at the end, even after an interrupt or an error.

    Calls `written` with their number then. Raises `ResultsError` if it cannot be written, and leaves an older video as
    it was.
    """
    with os_errors_as(f"the video {video} cannot be written"):
        scratch = tempfile.TemporaryDirectory(prefix="unfinished-", dir=video.parent)
    frames, broken = 0, False
    with scratch as folder:
        unfinished = Path(folder) / video.name
        # ffmpeg's own messages are pages long: what goes wrong is said in one line
        writer = imageio.get_writer(unfinished, fps=fps, ffmpeg_log_level="quiet", macro_block_size=2)

        def film(frame: NDArray[np.uint8]) -> None:
            nonlocal frames, broken
            frames += 1
            try:
                writer.append_data(frame)
            except OSError as error:
                broken = True
                raise ResultsError(
                    f"the video {video} cannot be written: ffmpeg gave up after {frames} frames"
                ) from error

        try:
            yield film
        finally:
            writer.close()
            if frames and not broken:
                check_frames(unfinished, frames, video)
                with os_errors_as(f"the video {video} cannot be written"):
                    write_atomically(video, unfinished.replace)
                written(frames)


def check_frames(path: Path, frames: int, name: object) -> None:
    """Raise `ResultsError`, which calls the video by `name`, if it does not have so many frames."""
    if (written := count_frames(path)) != frames:
        raise ResultsError(
            f"the video {name} cannot be written: {written} of its {frames} frames arrived, as on a full disk"
        )


def check_video(video: Path) -> None:
    """Raise `ConfigurationError` or `ResultsError` for a video that cannot be written, before anything is played."""
    check_writable("video", video, VIDEO_FORMATS)


def check_writable(kind: str, file: Path, suffixes: Sequence[str]) -> None:
    """Raise `ConfigurationError` or `ResultsError` for a file of some kind that cannot be written."""
    if file.suffix.lower() not in suffixes:
        ending = suffixes[0] if len(suffixes) == 1 else f"one of {', '.join(suffixes)}"
        raise ConfigurationError(f"a {kind}'s name ends in {ending}; {str(file)!r} does not")
    missing = not file.exists()
    try:
        file.open("ab").close()
        if missing:
            file.unlink()
    except OSError as error:
        why = error.strerror if file.parent.is_dir() else f"there is no folder {file.parent}"
        raise ResultsError(f"the {kind} {file} cannot be written: {why}") from error

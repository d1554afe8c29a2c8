"""Videos of a comparison's episodes, which are played again."""

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import imageio.v3 as imageio
import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from armctl import agents
from armctl.core.errors import ArmctlError, ResultsError, reason
from armctl.core.registration import check_named
from armctl.envs import ThirdPartyVectorEnv, check_from_file
from armctl.episodes.record import EpisodeResult
from armctl.episodes.table import EpisodeTable
from armctl.policies import is_code
from armctl.simulation.rendering import Camera
from armctl.study.comparison import Comparison
from armctl.viewer.recording import check_frames
from armctl.viewer.stage import Stage

Frame = NDArray[np.uint8]

SIZE = 400, 304
"""Pixels: multiples of 16, which H.264 needs."""
BRIEF = 50
"""Control steps. If most episodes are shorter, they are shown at half speed."""
MAX_FRAMES = 100
"""Frames of a video, or twice as many at half speed. Longer episodes show every second or third control step only."""
OFFSAMPLES, SHADOW = 0, 1024
"""MuJoCo's rendering quality. With it, software rendering takes half the time of the models' own quality."""
QUALITY = 27
"""H.264's constant rate factor: higher is smaller and worse."""
STILL_TIME = 1.0
"""s for which the last frame is shown."""


@dataclass(frozen=True)
class Clip:
    """One episode under one policy."""

    result: EpisodeResult
    video: bytes = b""
    """MP4."""
    still: bytes = b""
    """The last frame, as JPEG."""
    speed: float = 1.0
    """Relative to real time."""
    problem: str = ""
    """Reason for which there is no video, or its difference from the results."""


def largest_difference(episodes: Mapping[str, EpisodeTable]) -> list[EpisodeResult]:
    """Return the results of all policies in the episode in which their returns differ most; none for a single policy.

    The criterion is the sum of the logarithms of the gaps between neighbouring returns, so that one policy that always
    fails does not dominate it.
    """
    fewest = min(map(len, episodes.values()), default=0)
    tables = [table[:fewest] for table in episodes.values()]
    numbers, returns = (np.array([table.column(name) for table in tables]) for name in ("episode", "total_reward"))
    if len(tables) < 2 or not (shared := np.flatnonzero((numbers == numbers[0]).all(axis=0))).size:
        return []
    gaps = np.diff(np.sort(returns[:, shared].T, axis=1), axis=1)
    widest = int(shared[np.argmax(np.log1p(gaps).sum(axis=1))])
    return [table[widest] for table in tables]


def lowest_returns(episodes: Mapping[str, EpisodeTable]) -> list[EpisodeResult]:
    """Return the episode with the lowest return of each policy; of several, the first."""
    return [table[int(table.column("total_reward").argmin())] for table in episodes.values()]


def film(comparison: Comparison, selection: Sequence[EpisodeResult]) -> list[Clip]:
    """Videos of equal length and speed, which can be played side by side."""
    lengths = [result.length for result in selection]
    slowness = 2 if np.median(lengths) < BRIEF else 1
    stride = -(-max(lengths) // (slowness * MAX_FRAMES))
    recordings: list[_Recording | str] = []
    for result in selection:
        try:
            recordings.append(_play(comparison, result, stride))
        except ArmctlError as error:
            recordings.append(str(error))
    longest = max((len(recording.frames) for recording in recordings if isinstance(recording, _Recording)), default=0)
    clips = []
    for result, recording in zip(selection, recordings, strict=True):
        if isinstance(recording, str):
            clips.append(Clip(result, problem=recording))
            continue
        fps = 1 / (slowness * recording.period)
        frames = recording.frames + [recording.frames[-1]] * (longest - len(recording.frames) + round(STILL_TIME * fps))
        try:
            video = _mp4(frames, fps)
        except ResultsError as error:
            clips.append(Clip(result, problem=str(error)))
            continue
        still = imageio.imwrite("<bytes>", frames[-1], extension=".jpg", quality=80)
        clips.append(Clip(result, video, still, stride / slowness, recording.problem))
    return clips


@dataclass(frozen=True)
class _Recording:
    """An episode's images."""

    frames: list[Frame]
    period: float
    """The control period, s."""
    problem: str


def _play(comparison: Comparison, result: EpisodeResult, stride: int) -> _Recording:
    """Play an episode again, with an image at every `stride`-th control step and at the end."""
    name = result.policy
    check_from_file(comparison.env, comparison.env_options, "the comparison")
    if Path(name).suffix not in agents.FILES and is_code(name):
        check_named(name, "the comparison", "--policy")
    with (
        closing(
            Stage(
                name,
                comparison.env,
                comparison.seed,
                result.episode,
                comparison.env_options,
                render_mode="rgb_array",
                policy_seed=comparison.facts.policy_seed,
            )
        ) as stage,
        _pictures(stage) as picture,
    ):
        frames = [picture()]
        while stage.status.outcome is None:
            stage.step()
            if stage.status.steps % stride == 0 or stage.status.outcome is not None:
                frames.append(picture())
        ending = stage.status.outcome, stage.status.steps
        problem = (
            "" if ending == (result.outcome, result.length) else f"Played again: {ending[0]} after {ending[1]} steps."
        )
        return _Recording(frames, stage.period, problem)


@contextmanager
def _pictures(stage: Stage) -> Iterator[Callable[[], Frame]]:
    """Yield a function that takes a picture of the stage, of the size `SIZE`."""
    if isinstance(stage.worlds, ThirdPartyVectorEnv):
        model = getattr(stage.worlds.worlds[0].unwrapped, "model", None)
        if isinstance(model, mujoco.MjModel):
            _simplify(model)
        yield lambda: _fitted(stage.worlds.render()[0])
        return
    _simplify(stage.task.simulation.model)
    with closing(Camera(stage.task.simulation.model, stage.task.camera, *SIZE)) as camera:
        yield lambda: camera.picture(stage.task.simulation.data(0)).copy()


def _simplify(model: mujoco.MjModel) -> None:
    model.vis.quality.offsamples, model.vis.quality.shadowsize = OFFSAMPLES, SHADOW


def _fitted(frame: Frame) -> Frame:
    """Return a frame of any size in one of the size `SIZE`, on the colour of its corner."""
    image = ImageOps.pad(Image.fromarray(frame).convert("RGB"), SIZE, color=tuple(map(int, frame[0, 0])))
    return np.asarray(image)


def _mp4(frames: Sequence[Frame], fps: float) -> bytes:
    """Return the frames as MP4. Raises `ResultsError` if the disk for temporary files is full."""
    try:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "video.mp4"
            imageio.imwrite(
                path, np.array(frames), fps=fps, codec="libx264", pixelformat="yuv420p", quality=None,
                output_params=["-crf", str(QUALITY), "-movflags", "+faststart"],
            )  # fmt: skip
            check_frames(path, len(frames), "of the report")
            return path.read_bytes()
    except OSError as error:
        raise ResultsError(
            f"the video of the report cannot be written to {tempfile.gettempdir()}: {reason(error)}"
        ) from error

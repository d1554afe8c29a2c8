"""Episodes of a comparison, played again and filmed."""

import tempfile
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import imageio.v3 as imageio
import numpy as np
from numpy.typing import NDArray

from armctl.errors import ArmctlError, ConfigurationError
from armctl.evaluation.record import EpisodeResult
from armctl.evaluation.results import Results
from armctl.simulation.rendering import Camera
from armctl.viewer.stage import Stage

Frame = NDArray[np.uint8]

SIZE = 400, 304
"""Pixels: multiples of 16, as H.264 wants them."""
BRIEF = 50
"""Decisions; if most episodes are shorter, they are shown at half speed."""
MOST_FRAMES = 100
"""Of a video, or twice as many at half speed: of longer episodes it shows each second decision, or each third."""
OFFSAMPLES, SHADOW = 0, 1024
"""MuJoCo's rendering quality: software draws such a picture in half the time of one of the models' own quality."""
QUALITY = 27
"""H.264's constant rate factor: higher is smaller and worse."""
CURTAIN = 1.0
"""s for which the end stands still."""


@dataclass(frozen=True)
class Clip:
    """One episode under one policy."""

    result: EpisodeResult
    video: bytes = b""
    """MP4."""
    still: bytes = b""
    """The end, as JPEG."""
    speed: float = 1.0
    """Times real time."""
    problem: str = ""
    """Why there is no video, or what is odd about it."""


def most_different(episodes: Mapping[str, Sequence[EpisodeResult]]) -> list[EpisodeResult]:
    """The episode, of those that all policies have played, in which their returns differ most; none of one policy.

    The gaps between neighbours are added up as logarithms: one policy that always fails does not decide it alone.
    """
    played = list(zip(*episodes.values(), strict=False))
    if len(episodes) < 2 or not played:
        return []
    returns = np.array([[result.total_reward for result in results] for results in played])
    gaps = np.diff(np.sort(returns, axis=1), axis=1)
    return list(played[int(np.argmax(np.log1p(gaps).sum(axis=1)))])


def worst(episodes: Mapping[str, Sequence[EpisodeResult]]) -> list[EpisodeResult]:
    """The episode of the lowest return under each policy; of several, the first."""
    return [min(played, key=lambda result: result.total_reward) for played in episodes.values()]


def film(results: Results, wanted: Sequence[EpisodeResult], trusted: bool) -> list[Clip]:
    """Videos of equal length and speed, that can be played side by side; see `names_code` for `trusted`."""
    lengths = [result.length for result in wanted]
    slowness = 2 if np.median(lengths) < BRIEF else 1
    stride = -(-max(lengths) // (slowness * MOST_FRAMES))
    takes: list[_Take | str] = []
    for result in wanted:
        try:
            takes.append(_play(results, result, stride, trusted))
        except ArmctlError as error:
            takes.append(str(error))
    longest = max((len(take.frames) for take in takes if isinstance(take, _Take)), default=0)
    clips = []
    for result, take in zip(wanted, takes, strict=True):
        if isinstance(take, str):
            clips.append(Clip(result, problem=take))
            continue
        fps = 1 / (slowness * take.period)
        frames = take.frames + [take.frames[-1]] * (longest - len(take.frames) + round(CURTAIN * fps))
        still = imageio.imwrite("<bytes>", frames[-1], extension=".jpg", quality=80)
        clips.append(Clip(result, _mp4(frames, fps), still, stride / slowness, take.problem))
    return clips


def names_code(name: str) -> bool:
    """Whether a policy or an environment of this name is made by importing a module that it names.

    A name in somebody's folder is no reason to: it takes one that is trusted.
    """
    return ":" in name and Path(name).suffix not in (".onnx", ".json")


@dataclass(frozen=True)
class _Take:
    """An episode's pictures."""

    frames: list[Frame]
    period: float
    """s between two decisions."""
    problem: str


def _play(results: Results, result: EpisodeResult, stride: int, trusted: bool) -> _Take:
    """Play an episode again, with a picture of each `stride`-th decision and of the end."""
    name, comparison = result.policy, results.comparison
    for code in filter(names_code, (name, comparison.env)):
        if not trusted:
            raise ConfigurationError(
                f"{code} is code of its own, which armctl report does not call: armctl compare --report films it"
            )
    with closing(Stage(name, comparison.env, comparison.seed, result.episode, comparison.env_options)) as stage:
        quality = stage.task.simulation.model.vis.quality
        quality.offsamples, quality.shadowsize = OFFSAMPLES, SHADOW
        camera = Camera(stage.task.simulation.model, stage.task.camera, *SIZE)
        try:
            frames = [camera.picture(stage.task.simulation.data(0)).copy()]
            while stage.status.outcome is None:
                stage.step()
                if stage.status.steps % stride == 0 or stage.status.outcome is not None:
                    frames.append(camera.picture(stage.task.simulation.data(0)).copy())
        finally:
            camera.close()
        now = stage.status.outcome, stage.status.steps
        problem = "" if now == (result.outcome, result.length) else f"Played again: {now[0]} after {now[1]} steps."
        return _Take(frames, stage.period, problem)


def _mp4(frames: Sequence[Frame], fps: float) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        imageio.imwrite(
            path, np.array(frames), fps=fps, codec="libx264", pixelformat="yuv420p", quality=None,
            output_params=["-crf", str(QUALITY), "-movflags", "+faststart"],
        )  # fmt: skip
        return path.read_bytes()

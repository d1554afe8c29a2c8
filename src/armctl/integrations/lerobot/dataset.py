"""The files of a LeRobot dataset, version 3.0: Parquet, MP4 and metadata.

The format is that of `lerobot/datasets/lerobot_dataset.py` (Hugging Face, lerobot 0.4). That library cannot be
installed beside armctl's versions of PyTorch and others, so armctl writes the files itself. A frame is what a policy
saw, what it did, and what it got for that; the last observation of an episode is left out, as LeRobot does. Numbers
are in single precision, and images become 8-bit videos: the Minari format keeps every bit.
"""

import contextlib
import json
import os
from collections.abc import Iterable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import imageio
import numpy as np
from numpy.typing import NDArray

from armctl.core.errors import missing_extra
from armctl.core.files import sealed, write_atomically
from armctl.datasets.demonstrations import Demonstration
from armctl.datasets.pictures import bounds_of, count_frames, is_image, pictures
from armctl.envs import EpisodeVectorEnv, full_id
from armctl.integrations.lerobot.features import features_of, observed_parts
from armctl.integrations.lerobot.stats import Stats, aggregated, picture_stats, stats_of

PARTS: tuple[str, ...] = ("data", "videos", "meta")
"""The folders within the dataset's folder of which it consists; `videos` only with image observations."""
MANIFEST = "meta/armctl.json"
"""File for what LeRobot has no place for: the identity, and the episodes' seed, numbers and outcomes."""

FILE = "chunk-{chunk_index:03d}/file-{file_index:03d}"
FIRST = FILE.format(chunk_index=0, file_index=0)
AV1 = {
    "codec": "libaom-av1",
    "quality": None,
    "macro_block_size": 1,
    "ffmpeg_log_level": "quiet",
    "output_params": ["-usage", "realtime", "-cpu-used", "8", "-crf", "18", "-b:v", "0", "-g", "1"],
}
"""LeRobot's own codec, which Rerun plays without ffmpeg. Every frame is a key frame, so that any is found at once."""


def library_versions() -> dict[str, str]:
    """Versions of what writes the dataset; raises `ConfigurationError` if it is not installed."""
    try:
        import pyarrow
    except ModuleNotFoundError as error:
        raise missing_extra("a LeRobot dataset", error, "lerobot") from error
    return {"pyarrow": pyarrow.__version__}


def describe(folder: Path, env: str, env_options: Mapping[str, Any], worlds: EpisodeVectorEnv) -> dict[str, Any]:
    """LeRobot's `info`, without the counts of frames, and what it has no place for, as JSON values."""
    period = worlds.control_period or 1 / worlds.metadata["render_fps"]
    fps = Fraction(1 / period).limit_denominator(1000)
    observed = observed_parts(worlds.single_observation_space)
    return {
        "env": full_id(env),
        "env_options": {option: str(value) for option, value in env_options.items()},
        "interface": worlds.task.interface,
        "fps": str(fps),
        "task": worlds.task.instruction or f"Play {full_id(env)}.",
        "observations": {key: name for key, (name, _) in observed.items()},
        "bounds": {key: bounds_of(space) for key, (_, space) in observed.items() if is_image(space)},
        "info": {
            "codebase_version": "v3.0",
            "robot_type": worlds.task.interface.get("robot"),
            "fps": int(fps) if fps.denominator == 1 else float(fps),
            "chunks_size": 1000,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "data_path": f"data/{FILE}.parquet",
            "video_path": f"videos/{{video_key}}/{FILE}.mp4",
            "features": features_of(worlds, float(fps)),
        },
    }


def write_dataset(
    folder: Path, episodes: Iterable[tuple[Demonstration, Mapping[str, Any]]], metadata: Mapping[str, Any]
) -> None:
    """Write `PARTS` to a folder: episodes with their attributes, and metadata. Raises `OSError`."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    info, task, fps = dict(metadata["info"]), metadata["task"], Fraction(metadata["fps"])
    features: dict[str, Any] = info["features"]
    schema = pa.schema(
        [(key, _arrow_type(feature)) for key, feature in features.items() if feature["dtype"] != "video"]
    )
    rows: list[dict[str, Any]] = []
    about: list[Mapping[str, Any]] = []
    stats: dict[str, list[Stats]] = {key: [] for key in features}
    start = 0
    (folder / "meta").mkdir()
    with contextlib.ExitStack() as files:
        films = {
            key: files.enter_context(imageio.get_writer(_new(folder / f"videos/{key}/{FIRST}.mp4"), fps=fps, **AV1))
            for key in metadata["bounds"]
        }
        data = files.enter_context(pq.ParquetWriter(_new(folder / f"data/{FIRST}.parquet"), schema))
        for number, (episode, attributes) in enumerate(episodes):
            end = start + len(episode)
            frames = _frames(episode, metadata) | {
                "timestamp": np.arange(len(episode)) / float(fps),
                "frame_index": np.arange(len(episode)),
                "episode_index": np.full(len(episode), number),
                "index": np.arange(start, end),
                "task_index": np.zeros(len(episode)),
            }
            columns = {key: frames[key].astype(features[key]["dtype"]) for key in schema.names}
            data.write_table(pa.table([_arrow_array(columns[key]) for key in schema.names], schema))
            videos = {key: frames[key] for key in films}
            for key, film in films.items():
                for picture in videos[key]:
                    film.append_data(picture)
            episode_stats = {key: stats_of(values.reshape(len(episode), -1)) for key, values in columns.items()}
            episode_stats |= {key: picture_stats(values) for key, values in videos.items()}
            for key, part_stats in episode_stats.items():
                stats[key].append(part_stats)
            rows.append(_row(number, task, start, end, fps, films) | _flat_stats(episode_stats))
            about.append({"frames": len(episode), "terminated": episode.terminated, **attributes})
            start = end
    for key in films:
        _check_video(folder / f"videos/{key}/{FIRST}.mp4", start)
    info |= {
        "total_episodes": len(rows),
        "total_frames": start,
        "total_tasks": 1,
        "splits": {"train": f"0:{len(rows)}"},
    }
    _write_meta(folder, info, rows, stats, task)
    write_atomically(folder / MANIFEST, sealed({**metadata, "episodes": about}))


def _write_meta(
    folder: Path, info: Mapping[str, Any], rows: list[dict[str, Any]], stats: Mapping[str, list[Stats]], task: str
) -> None:
    """Write what LeRobot keeps of a dataset beside its frames, and have all files of it on the disk."""
    import pandas as pd
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.Table.from_pylist(rows), _new(folder / f"meta/episodes/{FIRST}.parquet"))
    pd.DataFrame({"task_index": [0]}, index=[task]).to_parquet(folder / "meta/tasks.parquet")
    together = {key: _lists(aggregated(parts)) for key, parts in stats.items()}
    for part in PARTS:
        _to_disk(folder / part)
    write_atomically(folder / "meta/info.json", json.dumps(info, indent=4))
    write_atomically(folder / "meta/stats.json", json.dumps(together, indent=4))


def _frames(episode: Demonstration, metadata: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Return an episode's features except for the counters, (T, ...) each."""
    frames: dict[str, NDArray[Any]] = {}
    for key, name in metadata["observations"].items():
        observations = episode.observations if name is None else episode.observations[name]
        values = np.asarray(observations)[:-1]
        frames[key] = _even(pictures(values, *metadata["bounds"][key])) if key in metadata["bounds"] else values
    last = np.arange(len(episode)) == len(episode) - 1
    return frames | {
        "action": episode.actions,
        "next.reward": episode.rewards,
        "next.done": last,
        "next.truncated": last & (not episode.terminated),
        "next.success": last & episode.success,
    }


def _even(images: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Pictures with sides of even numbers of pixels, as videos need them: the last row or column is repeated."""
    _, height, width, _ = images.shape
    return np.pad(images, ((0, 0), (0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def _row(number: int, task: str, start: int, end: int, fps: Fraction, videos: Iterable[str]) -> dict[str, Any]:
    """Return an episode's row in `meta/episodes`."""
    row: dict[str, Any] = {"episode_index": number, "tasks": [task], "length": end - start}
    row |= {"dataset_from_index": start, "dataset_to_index": end}
    for place in ("data", "meta/episodes", *(f"videos/{key}" for key in videos)):
        row |= {f"{place}/chunk_index": 0, f"{place}/file_index": 0}
    for key in videos:
        row |= {f"videos/{key}/from_timestamp": float(start / fps), f"videos/{key}/to_timestamp": float(end / fps)}
    return row


def _flat_stats(stats: Mapping[str, Stats]) -> dict[str, Any]:
    return {f"stats/{key}/{name}": value for key, part in stats.items() for name, value in _lists(part).items()}


def _lists(stats: Stats) -> dict[str, list[Any]]:
    return {name: value.tolist() for name, value in stats.items()}


def _arrow_type(feature: Mapping[str, Any]) -> Any:
    import pyarrow as pa

    (size,) = feature["shape"]
    kind = pa.from_numpy_dtype(np.dtype(feature["dtype"]))
    return kind if size == 1 else pa.list_(kind, size)


def _arrow_array(values: NDArray[Any]) -> Any:
    import pyarrow as pa

    flat, size = pa.array(np.ascontiguousarray(values).ravel()), values[0].size
    return flat if size == 1 else pa.FixedSizeListArray.from_arrays(flat, size)


def _new(path: Path) -> Path:
    path.parent.mkdir(parents=True)
    return path


def _to_disk(folder: Path) -> None:
    """Have the system write all files of a folder, so that a loss of power leaves them whole."""
    for path in filter(Path.is_file, folder.rglob("*")):
        with path.open("rb") as file:
            os.fsync(file.fileno())


def _check_video(path: Path, frames: int) -> None:
    """Raise `OSError` if a video does not have so many frames: ffmpeg does not say when a disk is full."""
    if (written := count_frames(path)) != frames:
        raise OSError(f"{written} of the {frames} frames of {path.name} arrived, as on a full disk")

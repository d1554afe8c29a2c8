"""LeRobot datasets, opened by LeRobot's own reader and by Rerun's, hold the episodes that were played."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import rerun
from rerun.chunk import RrdReader
from rerun.experimental import LeRobotReader

from armctl.core.errors import ConfigurationError, ResultsError
from armctl.datasets.collect import collect
from armctl.datasets.demonstrations import Demonstration
from armctl.datasets.minari import read_demonstrations
from armctl.envs import make_worlds
from armctl.integrations.lerobot import dataset as lerobot
from armctl.integrations.lerobot.stats import QUANTILES, aggregated, stats_of

from ..command_line import full_disk

LIBRARY = Path(sys.prefix) / "lerobot"
"""LeRobot, which cannot be installed beside armctl: `make .venv/lerobot`."""
READER = Path(__file__).with_name("read_lerobot.py")
ARM, BRIDGE = "armctl/ArmReach-v0", "armctl/BridgeCross-v0"
SHORT = {"max_episode_steps": 12}
SMALL = {"max_episode_steps": 10, "resolution": (33, 25)}
"""Odd numbers of pixels, which videos cannot have."""


def both(folder, env, episodes, options):
    """The same episodes in both formats: the LeRobot dataset, and the demonstrations of Minari's."""
    given = {"policy": "random", "env": env, "episodes": episodes, "worlds": 2, "env_options": options}
    collect(**given, out=folder / "lerobot", format="lerobot")
    collect(**given, out=folder / "minari")
    return folder / "lerobot", read_demonstrations(folder / "minari", make_worlds(env, 1, options))


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return both(tmp_path_factory.mktemp("arm"), ARM, 3, SHORT)


@pytest.fixture(scope="module")
def bridge(tmp_path_factory):
    return both(tmp_path_factory.mktemp("bridge"), BRIDGE, 2, SMALL)


@pytest.fixture(scope="module")
def read(arm, bridge, tmp_path_factory):
    """What LeRobot itself reads, by dataset: one process, which loads it for seconds."""
    assert LIBRARY.is_dir(), "make .venv/lerobot"
    folder = tmp_path_factory.mktemp("read")
    files = {dataset: folder / f"{number}.npz" for number, (dataset, _) in enumerate((arm, bridge))}
    done = subprocess.run(
        [sys.executable, READER, LIBRARY, *(path for pair in files.items() for path in pair)],
        capture_output=True,
        text=True,
        env=os.environ | {"HF_HOME": str(folder), "HF_HUB_OFFLINE": "1"},
    )
    assert done.returncode == 0, done.stderr
    return {dataset: dict(np.load(file)) for dataset, file in files.items()}


def check_frames(found, played, fps):
    lengths = [len(one) for one in played]
    assert (found["fps"], found["episodes"], len(found["index"])) == (fps, len(played), sum(lengths))
    np.testing.assert_array_equal(found["episode_index"], np.repeat(np.arange(len(played)), lengths))
    np.testing.assert_array_equal(found["frame_index"], np.concatenate([np.arange(length) for length in lengths]))
    np.testing.assert_allclose(found["timestamp"], found["frame_index"] / fps, rtol=1e-6)
    np.testing.assert_array_equal(found["action"], np.concatenate([one.actions for one in played]))
    rewards = np.concatenate([one.rewards for one in played])
    np.testing.assert_array_equal(found["next.reward"], rewards.astype(np.float32))
    last = np.cumsum(lengths) - 1
    assert np.flatnonzero(found["next.done"]).tolist() == last.tolist()
    assert found["next.success"][last].tolist() == [one.success for one in played]
    assert found["next.truncated"][last].tolist() == [not one.terminated for one in played]


@pytest.mark.slow
def test_lerobot_reads_what_an_arm_did(arm, read):
    dataset, played = arm
    found = read[dataset]
    check_frames(found, played, 25)
    states = np.concatenate([one.observations[:-1] for one in played])
    np.testing.assert_array_equal(found["observation.state"], states)
    assert set(found["tasks"]) == {"Move the end-effector to the target."}
    for name, value in {
        "min": states.min(0),
        "max": states.max(0),
        "mean": states.mean(0),
        "std": states.std(0),
    }.items():
        np.testing.assert_allclose(found[f"stats/observation.state/{name}"], value, rtol=1e-4, atol=1e-5)
    names = json.loads((dataset / "meta/info.json").read_text())["features"]
    assert names["observation.state"]["names"][3] == "joint_positions.shoulder_pan_joint"
    assert names["action"]["names"][5] == "wrist_3_joint"


@pytest.mark.slow
def test_lerobot_reads_what_a_camera_saw(bridge, read):
    dataset, played = bridge
    found = read[dataset]
    check_frames(found, played, 10)
    np.testing.assert_array_equal(
        found["observation.state"], np.concatenate([p.observations["motion"][:-1] for p in played])
    )
    depths = np.concatenate([one.observations["image"][:-1] for one in played])
    pictures = found["observation.images.image"]
    assert pictures.shape == (20, 3, 26, 34)
    error = np.abs(10 * pictures[:, :, :25, :33] - depths[:, None])  # m, of 10 m
    assert error.mean() < 0.1
    assert error.mean(axis=(1, 2, 3)).max() < 0.2  # in each of them: none is in the place of another
    assert found["stats/observation.images.image/mean"].shape == (3, 1, 1)


def scalars(chunks, path, component):
    """Rows of a component in a Rerun recording, by the entity's path."""
    rows = []
    for chunk in chunks:
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if chunk.entity_path == path and component in name and not chunk.is_static:
                rows += batch[name].to_pylist()
    return rows


@pytest.mark.slow
def test_rerun_reads_each_episode(arm, bridge, tmp_path):
    for dataset, played in (arm, bridge):
        reader = LeRobotReader(dataset)
        assert (reader.version, reader.episodes()) == ("v3", list(range(len(played))))
        for number, one in enumerate(played):
            chunks = reader.stream(number).to_chunks()
            np.testing.assert_array_equal(scalars(chunks, "/action", "scalars"), one.actions)
            frames = scalars(chunks, "/observation.images.image", "VideoFrameReference") or scalars(
                chunks, "/observation.images.image", "VideoStream:sample"
            )
            assert len(frames) == (len(one) if dataset == bridge[0] else 0)


def test_rerun_loads_the_folder(arm, tmp_path):
    stream = rerun.RecordingStream("test")
    stream.save(tmp_path / "dataset.rrd")
    stream.log_file_from_path(arm[0])
    stream.flush()
    stream.disconnect()
    found = {one.recording_id for one in RrdReader(tmp_path / "dataset.rrd").recordings()}
    assert {"episode_0", "episode_1", "episode_2"} <= found


def test_what_lerobot_has_no_place_for_is_kept(arm):
    about = json.loads((arm[0] / lerobot.MANIFEST).read_text())
    assert [one["options/episode"] for one in about["episodes"]] == [0, 1, 2]
    assert {one["outcome"] for one in about["episodes"]} == {"timeout"}
    assert about["seed"] == 0
    assert {"armctl-suite", "mujoco", "pyarrow"} <= set(about["versions"])


def test_the_statistics_of_episodes_make_up_those_of_the_whole():
    rng = np.random.default_rng(0)
    episodes = [rng.normal(size=(length, 4)) * rng.uniform(0, 9) for length in (1, 7, 50)]
    together, whole = aggregated([stats_of(one) for one in episodes]), stats_of(np.concatenate(episodes))
    for name in set(whole) - set(QUANTILES):
        np.testing.assert_allclose(together[name], whole[name], atol=1e-12)
    for name in QUANTILES:
        assert (whole["min"] <= together[name]).all()
        assert (together[name] <= whole["max"]).all()


def test_discrete_spaces_and_unknown_periods(tmp_path):
    collect("random", "CartPole-v1", episodes=2, out=tmp_path, env_options=SHORT, format="lerobot")
    frames = pd.read_parquet(tmp_path / "data/chunk-000/file-000.parquet")
    info = json.loads((tmp_path / "meta/info.json").read_text())
    assert (info["fps"], info["features"]["action"]["shape"]) == (50, [1])
    assert set(frames["action"]) <= {0, 1}
    assert info["total_frames"] == len(frames)
    assert pd.read_parquet(tmp_path / "meta/tasks.parquet").index.tolist() == ["Play CartPole-v1."]


def test_misspelt_format(tmp_path):
    with pytest.raises(ConfigurationError, match=r"no dataset format 'lerobo'. Did you mean 'lerobot'\? .* minari"):
        collect("random", episodes=1, out=tmp_path / "d", format="lerobo")
    assert not (tmp_path / "d").exists()


def test_a_missing_extra_is_named_in_a_line(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(
        ConfigurationError, match=r"^a LeRobot dataset needs pyarrow: pip install '.*\[lerobot\]'"
    ) as error:
        collect("random", episodes=1, out=tmp_path / "d", format="lerobot")
    assert "\n" not in str(error.value)


@pytest.mark.one_case
@pytest.mark.parametrize("formats", [("minari", "lerobot"), ("lerobot", "minari")])
def test_formats_do_not_mix_in_a_folder(tmp_path, formats):
    given = {"policy": "random", "episodes": 1, "out": tmp_path, "env_options": SHORT}
    collect(**given, format=formats[0])
    with pytest.raises(ResultsError, match=f"already holds a dataset in the format {formats[0]}: .*--overwrite"):
        collect(**given, format=formats[1])
    collect(**given, format=formats[1], overwrite=True)
    assert {one.name for one in tmp_path.iterdir() if one.is_dir()} == (
        {"data", "meta"} if formats[1] == "lerobot" else {"data"}
    )
    assert collect(**given, format=formats[1]).resumed == 1


def files(out):
    return {str(path.relative_to(out)): path.read_bytes() for path in sorted(out.glob("*/**/*")) if path.is_file()}


@pytest.fixture
def interrupted(tmp_path):
    """A collection of 4 episodes with 2 finished; its arguments."""

    def progress(finished):
        if finished == 2:
            raise KeyboardInterrupt

    given = {"policy": "random", "env": BRIDGE, "episodes": 4, "out": tmp_path / "d", "env_options": SMALL}
    given |= {"format": "lerobot"}
    assert collect(**given, progress=progress).interrupted
    return given


@pytest.mark.slow
def test_an_interrupt_keeps_what_is_finished_and_resumes_to_the_same_dataset(interrupted, tmp_path):
    assert len(pq.read_table(tmp_path / "d/meta/episodes")) == 2
    assert LeRobotReader(tmp_path / "d").episodes() == [0, 1]
    with pytest.raises(ResultsError, match="already holds a dataset in the format lerobot"):
        collect(**interrupted | {"format": "minari"})
    assert collect(**interrupted).resumed == 2
    collect(**interrupted | {"out": tmp_path / "whole", "worlds": 3})
    assert files(tmp_path / "d") == files(tmp_path / "whole")


class Killed(BaseException):
    """The end of the process, as far as one process can tell."""


@pytest.mark.slow
@pytest.mark.parametrize("moved", [0, 1, 2])
def test_an_end_while_parts_are_moved_loses_nothing(interrupted, monkeypatch, moved):
    real, left = Path.rename, iter(range(moved))

    def rename(path, target):
        if next(left, None) is None:
            raise Killed
        return real(path, target)

    monkeypatch.setattr(Path, "rename", rename)
    with pytest.raises(Killed):
        collect(**interrupted)
    monkeypatch.undo()
    assert collect(**interrupted).resumed == 4
    assert LeRobotReader(interrupted["out"]).episodes() == [0, 1, 2, 3]


@pytest.mark.parametrize("limit", [3_000, 30_000], ids=["the numbers do not fit", "the video does not fit"])
def test_a_full_disk_is_an_error(tmp_path, limit):
    worlds = make_worlds(BRIDGE, 1, {"resolution": (64, 64)})
    rng = np.random.default_rng(0)
    steps = 40
    seen = {"image": rng.uniform(0, 10, (steps + 1, 64, 64)), "motion": rng.normal(size=(steps + 1, 3))}
    episode = Demonstration(seen, rng.normal(size=(steps, 2)), rng.normal(size=steps), True, False)
    about = json.loads(json.dumps(lerobot.describe(tmp_path, BRIDGE, {}, worlds)))
    with full_disk(limit), pytest.raises(OSError, match=r"as on a full disk|too large|Broken pipe"):
        lerobot.write_dataset(tmp_path, [(episode, {})], about)
    assert not (tmp_path / lerobot.MANIFEST).exists()

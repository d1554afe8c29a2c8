"""Nothing that a collection has finished is lost: by kill -9, Ctrl-C, a full disk or a failing policy."""

import os
import random
import shutil
import signal
import subprocess
import time
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError, ResultsError
from armctl.core.files import one_writer
from armctl.datasets import minari as minari_files
from armctl.datasets.collect import collect
from armctl.datasets.minari import check_recordable, read_demonstrations
from armctl.episodes import PolicyFailed
from armctl.episodes.store import CellWriter
from armctl.study import cell as playing
from armctl.study.results import read_comparison

from ..command_line import armctl, program
from .collections_of_random import ARMCTL, COMMAND, EPISODES, SHORT, files, same_dataset, wait_for_episodes, worlds


def begin(out):
    return subprocess.Popen([ARMCTL, *COMMAND, "--out", out], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def kill_until_finished(out, kills, rng):
    """Run a collection, and kill it at random moments; the last run may finish."""
    for _ in range(kills):
        process = begin(out)
        before = len(list((out / "unfinished").glob("episode_*.npz")))
        wait_for_episodes(process, out, rng.randrange(before, EPISODES + 2))
        time.sleep(rng.uniform(0, 0.2))
        finished = len(list((out / "unfinished").glob("episode_*.npz")))
        process.send_signal(signal.SIGKILL)
        process.communicate()
        if finished:  # nothing of it is lost, unless it has become the dataset
            kept = len(list((out / "unfinished").glob("episode_*.npz")))
            assert kept >= finished or (out / "data/metadata.json").exists()
    return armctl(*COMMAND, "--out", out, cwd=out.parent).stdout


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.thorough) for seed in range(2, 6))])
def test_a_collection_that_is_killed_again_and_again_resumes_to_the_same_dataset(uninterrupted, seed, tmp_path):
    output = kill_until_finished(tmp_path / "killed-v0", 3 if seed == 1 else 5, random.Random(seed))
    assert "were there already" in output
    assert same_dataset(tmp_path / "killed-v0", uninterrupted)
    assert len(read_demonstrations(tmp_path / "killed-v0", worlds())) == EPISODES


@pytest.mark.slow
def test_ctrl_c_leaves_a_dataset_of_the_finished_episodes_and_the_same_command_resumes(uninterrupted, tmp_path):
    out = tmp_path / "here-v0"
    process = begin(out)
    wait_for_episodes(process, out, 40)
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate()
    assert process.returncode == 130, errors
    assert "The same command resumes" in output
    read = read_demonstrations(out, worlds())
    assert 40 <= len(read) < EPISODES
    assert f"{len(read)} episodes of random" in output
    again = armctl(*COMMAND, "--out", out, cwd=tmp_path)
    assert f"{len(read)} of {EPISODES} episodes were there already" in again.stdout
    assert same_dataset(out, uninterrupted)


def test_an_interrupt_between_keeping_and_counting_loses_nothing(tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as during:
        during.setattr(CellWriter, "write", interrupted)
        with pytest.raises(ResultsError, match="no episode was finished"):
            collect("random", episodes=3, out=tmp_path / "one-v0", env_options=SHORT)
    assert collect("random", episodes=3, out=tmp_path / "one-v0", env_options=SHORT).resumed == 0
    assert len(read_demonstrations(tmp_path / "one-v0", worlds())) == 3


@pytest.mark.slow
@pytest.mark.parametrize("limit", [2_000, 100_000], ids=["an episode does not fit", "the dataset does not fit"])
def test_a_full_disk_is_told_in_a_line_and_the_same_command_resumes(uninterrupted, limit, tmp_path):
    """A limit on the size of files stands for the disk: what crosses it fails as on a full one."""
    out = tmp_path / "full-v0"
    done = program(*COMMAND, "--out", out, cwd=tmp_path, check=False, disk=limit)
    assert done.returncode == 2, done.stderr
    assert done.stderr.startswith("armctl: ")
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert "written" in done.stderr
    assert not (out / "data").exists()
    kept = len(list((out / "unfinished").glob("episode_*.npz"))) if out.exists() else 0
    assert kept == (0 if limit == 2_000 else EPISODES)
    assert ("the same command resumes" in done.stderr) == bool(kept)
    again = program(*COMMAND, "--out", out, cwd=tmp_path)
    assert same_dataset(out, uninterrupted)
    assert ("were there already" in again.stdout) == bool(kept)


@pytest.mark.slow
def test_a_resumed_collection_plays_only_what_is_missing(interrupted, whole):
    seen = []
    collection = collect("random", episodes=9, out=interrupted, env_options=SHORT, progress=seen.append)
    assert (collection.resumed, collection.episodes, seen) == (5, 9, [1, 2, 3, 4, 5, 6, 7, 8, 9])
    assert same_dataset(interrupted, whole)
    played = read_demonstrations(whole, worlds())
    assert collection.steps == sum(map(len, played))
    assert collection.successes == sum(one.success for one in played)


@pytest.mark.slow
def test_a_finished_collection_is_left_as_it_is(interrupted):
    collect("random", episodes=9, out=interrupted, env_options=SHORT)
    before = files(interrupted)
    again = collect("random", episodes=9, out=interrupted, env_options=SHORT)
    assert (again.resumed, again.episodes) == (9, 9)
    assert files(interrupted) == before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"policy": "reach_ik"}, "random"),
        ({"seed": 1}, "seed: 0 there, 1 here"),
        ({"env_options": SHORT | {"tolerance": 0.1}}, "tolerance"),
        ({"env_options": {"max_episode_steps": 13}}, "max_episode_steps 12 there, 13 here"),
        ({"env": "armctl/ArmReachMoving-v0"}, "ArmReachMoving"),
        ({"episodes": 4}, "episode 4, beyond the 4"),
    ],
)
@pytest.mark.parametrize("finished", [False, True])
def test_collections_do_not_mix(interrupted, change, says, finished):
    same = {"policy": "random", "episodes": 9, "out": interrupted, "env_options": SHORT}
    if finished:
        collect(**same)
        says = says if "episodes" not in change else "of 9 episodes, not 4"
    before = files(interrupted)
    with pytest.raises(ResultsError, match=rf"holds.*{says}.*--overwrite"):
        collect(**same | change)
    assert files(interrupted) == before
    replaced = collect(**same | change, overwrite=True)
    assert replaced.resumed == 0
    assert replaced.episodes == change.get("episodes", 9)


def test_versions_are_part_of_what_a_collection_is(interrupted, monkeypatch):
    real = vars(playing)["identity"]
    monkeypatch.setattr(playing, "identity", lambda *given: real(*given) | {"versions": {"mujoco": "0.1"}})
    with pytest.raises(ResultsError, match=r"holds.*mujoco"):
        collect("random", episodes=9, out=interrupted, env_options=SHORT)


@pytest.mark.slow
def test_an_episode_that_is_damaged_is_played_again(interrupted, whole):
    one, other = interrupted / "unfinished/episode_1.npz", interrupted / "unfinished/episode_2.npz"
    content = bytearray(one.read_bytes())
    content[len(content) // 2] ^= 1
    one.write_bytes(content)
    other.write_bytes(b"")
    assert collect("random", episodes=9, out=interrupted, env_options=SHORT).resumed == 3
    assert same_dataset(interrupted, whole)


@pytest.mark.slow
def test_a_damaged_manifest_is_told(interrupted):
    collect("random", episodes=9, out=interrupted, env_options=SHORT)
    manifest = interrupted / "data/metadata.json"
    text = manifest.read_text()
    for changed in (text.replace('"seed": 0', '"seed": 1'), text[:100], "[]", ""):
        manifest.write_text(changed)
        with pytest.raises(ResultsError, match="damaged"):
            collect("random", episodes=9, out=interrupted, env_options=SHORT)


@pytest.mark.slow
def test_a_dataset_whose_results_are_lost_is_not_replaced(interrupted):
    collect("random", episodes=9, out=interrupted, env_options=SHORT)
    before = files(interrupted)
    for name in ("results.sqlite", "summary.json", "episodes.csv", "decisions.csv"):
        (interrupted / name).unlink()
    with pytest.raises(ResultsError, match=r"not all results of it.*--overwrite"):
        collect("random", episodes=9, out=interrupted, env_options=SHORT)
    assert files(interrupted) == before


def test_a_collection_is_a_comparison_of_one_policy(interrupted):
    comparison = read_comparison(interrupted)
    assert comparison.results.column("episode").tolist() == [0, 1, 2, 3, 4]
    assert comparison.interrupted


def test_a_policy_that_fails_leaves_what_was_finished_and_resumes(tmp_path):
    def failing(env):
        policy = random_policy(env)
        plain, calls = policy.act, iter(range(30))

        def act(observations):
            if next(calls, None) is None and (tmp_path / "tired").exists():
                raise ZeroDivisionError("tired")
            return plain(observations)

        policy.act = act
        return policy

    (tmp_path / "tired").touch()
    given = {"episodes": 4, "out": tmp_path / "d", "env_options": SHORT}
    with pytest.raises(PolicyFailed, match="tired"):
        collect(failing, **given)
    assert len(read_demonstrations(tmp_path / "d", worlds())) == 2
    (tmp_path / "tired").unlink()
    assert collect(failing, **given).resumed == 2
    assert len(read_demonstrations(tmp_path / "d", worlds())) == 4


def random_policy(env):
    from armctl.policies import make_policy

    return make_policy("random", env)


def test_one_process_writes_at_a_time(interrupted):
    with one_writer(interrupted), pytest.raises(ResultsError, match="another process"):
        collect("random", episodes=9, out=interrupted, env_options=SHORT)


@pytest.mark.parametrize("name", ["data", "unfinished"])
def test_nothing_is_written_through_a_symbolic_link(tmp_path, name):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere/precious").touch()
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / name).symlink_to(tmp_path / "elsewhere")
    for overwrite in (False, True):
        with pytest.raises(ResultsError, match="symbolic link"):
            collect("random", episodes=1, out=tmp_path / "d", overwrite=overwrite)
    assert os.listdir(tmp_path / "elsewhere") == ["precious"]


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("name", ["data/train.csv", "data/metadata.json", "unfinished/draft.txt", "summary.json"])
def test_what_armctl_has_not_written_is_not_replaced(tmp_path, name, overwrite):
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / name).write_text("{}")
    with pytest.raises(ResultsError, match=r"would be replaced, and armctl did not write it: choose another folder"):
        collect("random", episodes=1, out=tmp_path, env_options=SHORT, overwrite=overwrite)
    assert (tmp_path / name).read_text() == "{}"
    assert not (tmp_path / "results.sqlite").exists()


def test_other_files_in_the_folder_stay(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    collect("random", episodes=1, out=tmp_path, env_options=SHORT)
    collect("random", episodes=1, out=tmp_path, seed=1, env_options=SHORT, overwrite=True)
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize(
    "space",
    [
        gymnasium.spaces.Text(5),
        gymnasium.spaces.Tuple([gymnasium.spaces.Discrete(2)]),
        gymnasium.spaces.Dict(deep=gymnasium.spaces.Dict(deeper=gymnasium.spaces.Discrete(2))),
    ],
)
def test_what_no_array_holds_is_not_recorded(space):
    env = worlds()
    env.single_observation_space = space
    with pytest.raises(ConfigurationError, match="arrays of numbers"):
        check_recordable(env)


def test_numbers_are_kept_to_the_last_bit(interrupted):
    env = worlds()
    before = read_demonstrations(interrupted, env)
    collect("random", episodes=9, out=interrupted, env_options=SHORT)
    for first, again in zip(before, read_demonstrations(interrupted, env)[:5], strict=True):
        np.testing.assert_array_equal(first.observations, again.observations)
        np.testing.assert_array_equal(first.actions, again.actions)
        assert first.actions.dtype == again.actions.dtype


class Killed(BaseException):
    """The end of the process, as far as one process can tell."""


@pytest.mark.slow
@pytest.mark.parametrize("step", ["write_dataset", "sealed", "rename", "rmtree"])
@pytest.mark.parametrize("after", [False, True])
def test_an_end_while_the_dataset_is_assembled_loses_nothing(interrupted, whole, monkeypatch, step, after):
    place = {"write_dataset": minari_files, "sealed": minari_files, "rename": Path, "rmtree": shutil}[step]
    real = getattr(place, step)

    def killed(*given):
        if after:
            real(*given)
        raise Killed

    monkeypatch.setattr(place, step, killed)
    with pytest.raises(Killed):
        collect("random", episodes=9, out=interrupted, env_options=SHORT)
    monkeypatch.undo()
    assert len(list((interrupted / "unfinished").glob("episode_*.npz"))) == 9 or step == "rmtree"
    assert collect("random", episodes=9, out=interrupted, env_options=SHORT).resumed == 9
    assert same_dataset(interrupted, whole)

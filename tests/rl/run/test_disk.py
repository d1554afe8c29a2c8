"""Trainings on a disk that is full: one line, whole files, and a training that can be resumed."""

import threading
from pathlib import Path

import pytest

from armctl.core.errors import ResultsError
from armctl.rl.run.disk import raise_on_full_disk
from tests.command_line import armctl

COMMON = ["--set", "max_episode_steps=9", "--option", "validation_episodes=2", "--option", "evaluation_episodes=2"]
TRAININGS = {
    "reach_ppo": ["--steps", "200", "--option", "worlds=8", "--option", "batch_size=64"],
    "reach_sac": [
        "--steps",
        "300",
        "--option",
        "worlds=8",
        "--option",
        "random_steps=50",
        "--option",
        "buffer_size=500",
    ],
    "reach_bc": ["--steps", "20", "--option", "worlds=4", "--option", "demonstrations=4"],
    "reach_dagger": ["--steps", "20", "--option", "worlds=4", "--option", "demonstrations=4", "--option", "rounds=2"],
}


def train(recipe, folder, *more, **options):
    return armctl("train", recipe, *TRAININGS[recipe], *COMMON, "--out", "run", *more, cwd=folder, **options)


def files(run):
    found = (path for path in run.rglob("*") if path.is_file() and path.parent.name != "tensorboard")
    return {str(path.relative_to(run)): path.stat().st_size for path in found}


@pytest.mark.slow
@pytest.mark.parametrize(
    "recipe",
    ["reach_ppo", *(pytest.param(name, marks=pytest.mark.thorough) for name in TRAININGS if name != "reach_ppo")],
)
def test_a_full_disk_is_told_in_one_line_and_the_training_can_be_resumed(recipe, tmp_path):
    (tmp_path / "whole").mkdir()
    train(recipe, tmp_path / "whole")
    whole = files(tmp_path / "whole" / "run")
    for disk in (300, max(whole.values()) * 9 // 10):  # nothing, and all but the largest file
        folder = tmp_path / str(disk)
        folder.mkdir()
        done = train(recipe, folder, check=False, disk=disk)
        said = [line for line in done.stderr.splitlines() if line.startswith("armctl: ")]
        assert (done.returncode, len(said), "Traceback" in done.stderr) == (2, 1, False), done.stderr
        assert said[0].startswith("armctl: the training cannot be written to run: File too large")
        left = files(folder / "run")
        assert {name for name in left if "unfinished" in name} == set()
        for name, size in left.items():
            assert size == pytest.approx(whole[name], rel=0.1, abs=200)  # no half ones
        if "settings.json" in left:
            assert "--resume" in said[0]
            train(recipe, folder, "--resume")
            assert (folder / "run" / "agent.json").exists()


def test_other_errors_than_of_the_disk_are_not_taken_for_it(tmp_path):
    with pytest.raises(FileNotFoundError), raise_on_full_disk(tmp_path):
        (tmp_path / "nothing").read_text()
    with pytest.raises(ResultsError, match="No space left on device"), raise_on_full_disk(tmp_path):
        Path("/dev/full").write_text("x" * 10**6)


def test_threads_that_hand_their_errors_over_do_not_print_them(tmp_path, monkeypatch):
    class Writer(threading.Thread):
        exception = None

        def run(self):
            self.exception = OSError(28, "No space left on device")
            raise self.exception

    class Broken(threading.Thread):
        def run(self):
            raise OSError("somebody else's")

    told = []
    monkeypatch.setattr(threading, "excepthook", told.append)
    before = threading.excepthook
    with raise_on_full_disk(tmp_path):
        for thread in (Writer(), Broken()):
            thread.start()
            thread.join()
    assert threading.excepthook == before
    assert [str(failed.exc_value) for failed in told] == ["somebody else's"]

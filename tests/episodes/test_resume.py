"""A folder goes on where it was, plays nothing twice, and refuses what is another comparison."""

import contextlib
import json
import os

import pandas as pd
import pytest

from armctl.core.errors import ResultsError
from armctl.core.files import sealed
from armctl.episodes.stored import STORE
from armctl.robot_description import load_arm
from armctl.study import compare
from armctl.study.results import read_comparison

from ..command_line import armctl
from ..stores import one_cell, read_cell, timeless
from .stored import contents, edit

POLICIES = ["random", "reach_ik"]


OPTIONS = {"max_episode_steps": 5}


def run(out, episodes=3, policies=POLICIES, **arguments):
    return compare(policies, episodes=episodes, out=out, **{"env_options": OPTIONS} | arguments)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    run(folder)
    return folder


@pytest.fixture
def folder(finished, tmp_path):
    for path in finished.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


def test_the_same_command_plays_nothing_twice(folder):
    before = (folder / "episodes.csv").read_text()
    told = []
    again = run(folder, progress=told.append)
    assert again.resumed == len(told) == 6
    assert (folder / "episodes.csv").read_text() == before  # times included: nothing was played
    assert json.loads((folder / "summary.json").read_text())["policies"][1]["decision_ms_p50"] > 0


def test_what_is_missing_is_played_and_put_in_its_place(folder, finished):
    before = (folder / "episodes.csv").read_text().splitlines()
    edit(folder, "DELETE FROM episode_row WHERE episode != 2 OR policy != 0")
    assert run(folder, worlds=2).resumed == 1
    assert timeless(folder).equals(timeless(finished))
    assert (folder / "episodes.csv").read_text().splitlines()[3] == before[3]


def test_more_episodes_go_on_from_fewer(folder):
    assert run(folder, episodes=4).resumed == 6
    assert timeless(folder).groupby("policy").size().to_dict() == {"random": 4, "reach_ik": 4}
    with pytest.raises(ResultsError, match="beyond the 3 asked for"):
        run(folder, episodes=3)


def test_without_a_folder_the_results_are_the_same(finished):
    found = compare(POLICIES, episodes=3, env_options=OPTIONS, policy_seed=read_comparison(finished).facts.policy_seed)
    pd.testing.assert_frame_equal(timeless(found.episodes), timeless(read_comparison(finished).episodes))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"seed": 1}, "seed: 0 there, 1 here"),
        ({"policies": ["random"]}, "policies"),
        ({"env_options": {"max_episode_steps": 6}}, "env_options"),
        ({"env": "armctl/ArmReachMoving-v0"}, "env: armctl/ArmReach-v0 there"),
    ],
)
def test_another_comparison_is_refused(folder, change, says):
    with pytest.raises(ResultsError, match=says):
        run(folder, **change)


def test_other_versions_are_another_comparison(folder):
    told = read_cell(folder).identity
    told["versions"]["mujoco"] = "3.3.0"
    edit(folder, f"UPDATE cell SET identity = '{sealed(told)}'")
    with pytest.raises(ResultsError, match=r"versions: mujoco 3\.3\.0 there"):
        run(folder)
    with pytest.raises(ResultsError, match="belongs to another comparison"):
        read_comparison(folder)


def test_a_folder_has_one_writer(folder):
    before = contents(folder)
    with one_cell(folder, read_cell(folder).identity, 3):
        with pytest.raises(ResultsError, match="another process writes"):
            run(folder, seed=1, overwrite=True)
        with pytest.raises(ResultsError, match="another process writes"):
            read_comparison(folder)
    with pytest.raises(ResultsError, match="is unfinished"):
        read_comparison(folder)
    assert run(folder).resumed == 6
    assert contents(folder)["episodes.csv"] == before["episodes.csv"]


@pytest.mark.one_case
@pytest.mark.parametrize("name", [STORE, f"{STORE}-wal", "episodes.csv", "summary.json", ".lock"])
def test_nothing_is_written_through_a_link(folder, tmp_path_factory, name):
    victim = tmp_path_factory.mktemp("elsewhere") / "victim"
    victim.write_bytes((folder / STORE).read_bytes())
    (folder / name).unlink(missing_ok=True)
    (folder / name).symlink_to(victim)
    before = victim.read_bytes()
    for arguments in ({}, {"overwrite": True, "seed": 1}):
        with contextlib.suppress(ResultsError):
            run(folder, episodes=4, **arguments)
    assert victim.read_bytes() == before


def test_a_pipe_instead_of_a_file_does_not_hang(folder):
    (folder / STORE).unlink()
    os.mkfifo(folder / STORE)
    for use in (run, read_comparison):
        with pytest.raises(ResultsError, match="not a regular file"):
            use(folder)
    assert run(folder, overwrite=True).resumed == 0


STILL = """
import helper

def still(observation):
    return observation[3:9] * helper.GAIN
"""


@pytest.mark.slow
@pytest.mark.parametrize("edited", ["still.py", "helper.py"])
def test_edited_code_is_another_comparison(tmp_path, edited):
    (tmp_path / "still.py").write_text(STILL)
    (tmp_path / "helper.py").write_text("GAIN = 1.0\n")
    command = ["compare", "still.py:still", "--episodes", "2", "--out", "out", "--set", "max_episode_steps=3"]
    armctl(*command, cwd=tmp_path)
    assert "were finished by an earlier run" in armctl(*command, cwd=tmp_path).stdout
    with (tmp_path / edited).open("a") as file:
        file.write("# another gain\n")
    refused = armctl(*command, cwd=tmp_path, check=False)
    assert refused.returncode == 2
    assert f"code: {edited}" in refused.stderr
    armctl(*command, "--overwrite", cwd=tmp_path)


@pytest.mark.slow
def test_an_edited_robot_is_another_comparison(tmp_path):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(load_arm("ur5").urdf)
    options = OPTIONS | {"robot": str(urdf), "tip": "tool0"}
    run(tmp_path / "out", policies=["random"], env_options=options)
    assert run(tmp_path / "out", policies=["random"], env_options=options).resumed == 3
    urdf.write_text(urdf.read_text().replace('effort="150.0"', 'effort="120.0"'))
    with pytest.raises(ResultsError, match=r"files: .*model: "):
        run(tmp_path / "out", policies=["random"], env_options=options)


def test_a_folder_that_cannot_be_written_is_told(folder):
    with pytest.raises(ResultsError, match="cannot be written"):
        run("/proc/results")
    if os.geteuid():  # root may write anywhere
        folder.chmod(0o500)
        with pytest.raises(ResultsError, match="cannot be written"):
            run(folder)
        folder.chmod(0o700)

import contextlib
import dataclasses
import json
import math
import os
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from armctl.core.errors import ResultsError
from armctl.core.files import one_writer, sealed, unsealed
from armctl.episodes.record import TIME_COLUMNS
from armctl.episodes.store import EpisodeLog, read_episodes
from armctl.robot_description import load_arm
from armctl.study import compare
from armctl.study.results import read_results

from ..command_line import program

POLICIES = ["random", "reach_ik"]
OPTIONS = {"max_episode_steps": 5}


def run(out, episodes=3, policies=POLICIES, **arguments):
    return compare(policies, episodes=episodes, out=out, **{"env_options": OPTIONS} | arguments)


def timeless(folder):
    return pd.read_csv(folder / "episodes.csv").drop(columns=list(TIME_COLUMNS))


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    run(folder)
    return folder


@pytest.fixture
def folder(finished, tmp_path):
    for name in ("comparison.json", "episodes.csv", "decisions.csv", "summary.json", ".lock"):
        (tmp_path / name).write_text((finished / name).read_text())
    return tmp_path


def lines_of(path):
    return path.read_text().splitlines(keepends=True)


def test_the_same_command_plays_nothing_twice(folder):
    before = (folder / "episodes.csv").read_text()
    told = []
    again = run(folder, progress=told.append)
    assert again.resumed == len(told) == 6
    assert (folder / "episodes.csv").read_text() == before  # times included: nothing was played
    assert json.loads((folder / "summary.json").read_text())["policies"][1]["decision_ms_p50"] > 0


def test_what_is_missing_is_played_and_put_in_its_place(folder, finished):
    rows, times = (lines_of(folder / name) for name in ("episodes.csv", "decisions.csv"))
    (folder / "episodes.csv").write_text("".join([rows[0], rows[6], rows[1]]))  # the header, and two of six
    (folder / "decisions.csv").write_text("".join([times[0], times[1], *times[4:]]))
    again = run(folder, worlds=2)
    assert again.resumed == 2
    assert timeless(folder).equals(timeless(finished))
    after = lines_of(folder / "episodes.csv")
    assert (after[1], after[6]) == (rows[1], rows[6])


def test_more_episodes_go_on_from_fewer(folder):
    assert run(folder, episodes=4).resumed == 6
    assert timeless(folder).groupby("policy").size().to_dict() == {"random": 4, "reach_ik": 4}
    with pytest.raises(ResultsError, match="beyond the 3 asked for"):
        run(folder, episodes=3)


@pytest.mark.parametrize("name", ["episodes.csv", "decisions.csv"])
def test_a_last_line_cut_off_is_played_again(folder, finished, name):
    text = (folder / name).read_text()
    (folder / name).write_text(text[:-9])
    assert run(folder).resumed == 5
    assert timeless(folder).equals(timeless(finished))


@pytest.mark.parametrize(
    ("name", "spoil", "says"),
    [
        ("episodes.csv", lambda rows: [rows[0], rows[1].replace("timeout,", "timeout,perhaps,"), *rows[2:]], "line 2"),
        ("episodes.csv", lambda rows: [rows[0], rows[1], rows[2].replace("False", "Flase"), *rows[3:]], "line 3"),
        ("episodes.csv", lambda rows: [*rows, rows[2]], "second time"),
        ("episodes.csv", lambda rows: [*rows[:2], rows[2].replace(",0,timeout", ",7,timeout"), *rows[3:]], "line 3"),
        ("episodes.csv", lambda rows: ["policy,episode\n", *rows[1:]], "columns"),
        ("decisions.csv", lambda rows: [*rows[:3], rows[3].replace(" ", " soon "), *rows[4:]], "line 4"),
        ("decisions.csv", lambda rows: [*rows[:3], rows[3].replace("\n", " 0.1\n"), *rows[4:]], "line 4"),
        ("episodes.csv", lambda rows: [*rows[:1], rows[1].replace(",5,", ",4,"), *rows[2:]], "was changed"),
        ("episodes.csv", lambda rows: [*rows[:1], rows[1].replace("-5.0", "-4.0"), *rows[2:]], "was changed"),
        ("decisions.csv", lambda rows: [*rows[:1], rows[1].replace("\n", "1\n"), *rows[2:]], "was changed"),
        ("comparison.json", lambda rows: [row.replace('"seed": 0', '"seed": 1') for row in rows], "checksum"),
        ("comparison.json", lambda rows: ["[" * 100_000], "nested too deeply"),
        ("comparison.json", lambda rows: rows[:3], "without a readable comparison.json"),
    ],
)
def test_damage_is_told_and_nothing_is_touched(folder, name, spoil, says):
    (folder / name).write_text("".join(spoil(lines_of(folder / name))))
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with pytest.raises(ResultsError, match=says):
        run(folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert run(folder, overwrite=True).resumed == 0


@pytest.mark.parametrize("earned", [math.inf, -math.inf, math.nan, 1e101, -1e308])
@pytest.mark.parametrize("change", [lambda r: {"total_reward": r}, lambda r: {"reward_terms": {"step": -5.0, "x": r}}])
def test_a_return_beyond_statistics_is_told(folder, change, earned):
    own = unsealed((folder / "comparison.json").read_text())
    results = list(read_episodes(folder, own))
    results[0] = dataclasses.replace(results[0], **change(earned))
    with EpisodeLog(folder, own, len(results), overwrite=True) as log:
        log.finish(results, {})
    with pytest.raises(ResultsError, match=r"episodes.csv is damaged in line 2 \((return|reward_terms).* 1e\+100"):
        read_episodes(folder, own)


@pytest.mark.parametrize(
    "times", ["nan nan nan nan nan", "nan 1.0 1.0 1.0 1.0", "inf 1.0 1.0 1.0 1.0", "-1.0 1.0 1.0 1.0 1.0"]
)
def test_decision_times_that_are_none_are_told(folder, times):
    own = unsealed((folder / "comparison.json").read_text())
    results = list(read_episodes(folder, own))
    results[0] = dataclasses.replace(results[0], decision_ms=np.array(times.split(), dtype=float))
    with EpisodeLog(folder, own, len(results), overwrite=True) as log:
        log.finish(results, {})
    with pytest.raises(ResultsError, match=r"damaged in line 2 \(its decision times are no times"):
        read_episodes(folder, own)


def test_bytes_that_are_no_text_are_told(folder):
    (folder / "episodes.csv").write_bytes(b"\xff\xfe\x00\n")
    with pytest.raises(ResultsError, match="cannot be read"):
        run(folder)


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
    told = unsealed((folder / "comparison.json").read_text())
    told["versions"]["mujoco"] = "3.3.0"
    (folder / "comparison.json").write_text(sealed(told))
    with pytest.raises(ResultsError, match=r"versions: mujoco 3\.3\.0 there"):
        run(folder)


def test_rows_of_another_comparison_are_noticed(folder, tmp_path):
    run(tmp_path / "other", env_options={"max_episode_steps": 5, "tolerance": 0.2})
    for name in ("episodes.csv", "decisions.csv"):
        (folder / name).write_bytes((tmp_path / "other" / name).read_bytes())
    with pytest.raises(ResultsError, match="another comparison"):
        run(folder)
    with pytest.raises(ResultsError, match="another comparison"):
        read_results(folder)


def test_a_changed_digit_of_the_summary_is_noticed(folder):
    text = (folder / "summary.json").read_text()
    (folder / "summary.json").write_text(text.replace('"episodes": 3', '"episodes": 4'))
    with pytest.raises(ResultsError, match="checksum"):
        read_results(folder)


def test_a_folder_has_one_writer(folder):
    before = (folder / "episodes.csv").read_bytes()
    with one_writer(folder), pytest.raises(ResultsError, match="another process writes"):
        run(folder, seed=1, overwrite=True)
    assert (folder / "episodes.csv").read_bytes() == before
    assert run(folder).resumed == 6


def test_a_killed_process_holds_no_folder(folder):
    code = "import sys, time; from pathlib import Path; from armctl.core.files import one_writer\n"
    code += f"with one_writer(Path({str(folder)!r})): print('held', flush=True); time.sleep(60)"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "held\n"
        with pytest.raises(ResultsError, match="another process writes"):
            run(folder)
        holder.kill()
        holder.wait()
        assert run(folder).resumed == 6


@pytest.mark.parametrize("name", ["episodes.csv", "decisions.csv", "summary.json", "comparison.json", ".lock"])
def test_nothing_is_written_through_a_link(folder, tmp_path, name):
    victim = tmp_path / "victim"
    victim.write_text("precious")
    (folder / name).unlink()
    (folder / name).symlink_to(victim)
    with contextlib.suppress(ResultsError):
        run(folder)
    with contextlib.suppress(ResultsError):
        run(folder, overwrite=True, seed=1)
    assert victim.read_text() == "precious"


def test_a_pipe_instead_of_a_file_does_not_hang(folder):
    (folder / "decisions.csv").unlink()
    os.mkfifo(folder / "decisions.csv")
    with pytest.raises(ResultsError, match="not a regular file"):
        run(folder)


STILL = """
import helper

def still(observation):
    return observation[3:9] * helper.GAIN
"""


@pytest.mark.parametrize("edited", ["still.py", "helper.py"])
def test_edited_code_is_another_comparison(tmp_path, edited):
    """Each run in a process of its own: Python does not notice that a module has changed."""
    (tmp_path / "still.py").write_text(STILL)
    (tmp_path / "helper.py").write_text("GAIN = 1.0\n")
    command = ["compare", "still.py:still", "--episodes", "2", "--out", "out", "--set", "max_episode_steps=3"]
    program(*command, cwd=tmp_path)
    assert "were finished by an earlier run" in program(*command, cwd=tmp_path).stdout
    with (tmp_path / edited).open("a") as file:
        file.write("# another gain\n")
    refused = program(*command, cwd=tmp_path, check=False)
    assert refused.returncode == 2
    assert f"code: {edited}" in refused.stderr
    program(*command, "--overwrite", cwd=tmp_path)


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

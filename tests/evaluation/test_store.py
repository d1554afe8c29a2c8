import json
import os

import pandas as pd
import pytest

from armctl.errors import ResultsError
from armctl.evaluation import compare
from armctl.evaluation.record import TIME_COLUMNS

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
    for name in ("comparison.json", "episodes.csv", "decisions.csv", "summary.json"):
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
        ("decisions.csv", lambda rows: [*rows[:3], rows[3].replace("\n", " 0.1\n"), *rows[4:]], "episodes.csv"),
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
    told = json.loads((folder / "comparison.json").read_text())
    told["versions"]["mujoco"] = "3.3.0"
    (folder / "comparison.json").write_text(json.dumps(told))
    with pytest.raises(ResultsError, match="versions"):
        run(folder)


def test_a_folder_that_cannot_be_written_is_told(folder):
    with pytest.raises(ResultsError, match="cannot be written"):
        run("/proc/results")
    if os.geteuid():  # root may write anywhere
        folder.chmod(0o500)
        with pytest.raises(ResultsError, match="cannot be written"):
            run(folder)
        folder.chmod(0o700)

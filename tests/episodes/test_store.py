"""The store of a results folder: what is finished is never lost, doubled or mixed, and what is damaged is told."""

import contextlib
import json
import math
import os
import random
import signal
import sqlite3
import subprocess
import sys
import time
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from armctl.core.errors import ResultsError
from armctl.core.files import sealed
from armctl.episodes import rows as rows_module
from armctl.episodes.database import FORMAT
from armctl.episodes.metrics import Metrics
from armctl.episodes.record import TIME_COLUMNS, EpisodeResult
from armctl.episodes.store import Store
from armctl.episodes.stored import STORE, read_store
from armctl.robot_description import load_arm
from armctl.study import compare
from armctl.study.results import read_comparison

from ..command_line import full_disk, program
from ..made_up_episodes import OWN, played, same
from ..stores import one_cell, read_cell

POLICIES = ["random", "reach_ik"]
OPTIONS = {"max_episode_steps": 5}
NUMBERS, RETURNS = (st.floats(*limits).map(lambda x: x + 0.0) for limits in ((), (-1e100, 1e100)))  # no -0.0
MAYBE_INT, MAYBE_BOOL = st.none() | st.integers(0, 2**40), st.none() | st.booleans()
NAMES = st.text(st.characters(codec="utf-8"), max_size=8)
KINDS: dict[Any, Any] = {int: st.integers(0, 2**40), float: NUMBERS}
METRICS = st.builds(
    Metrics,
    **{one.name: KINDS.get(one.type, MAYBE_INT) for one in fields(Metrics)},
)


def run(out, episodes=3, policies=POLICIES, **arguments):
    return compare(policies, episodes=episodes, out=out, **{"env_options": OPTIONS} | arguments)


def timeless(folder):
    return pd.read_csv(folder / "episodes.csv").drop(columns=list(TIME_COLUMNS))


def write(folder, results, identity=OWN):
    with one_cell(folder, identity, 2**62, overwrite=True) as store:
        for result in results:
            store.write(result)
        store.finish({}, [])


def resume(folder):
    with one_cell(folder, OWN, 12):
        pass


def edit(folder, *commands):
    """Change a store as another program would."""
    with contextlib.closing(sqlite3.connect(folder / STORE)) as file, file:
        for command in commands:
            file.execute(command)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


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


@pytest.fixture
def made_up(tmp_path):
    write(tmp_path, played(12, "ba"))
    return tmp_path


@st.composite
def results(draw):
    times = draw(st.lists(st.floats(0, 1e9) | st.just(math.nan) | st.integers(0, 10**6).map(lambda k: k / 1e4)))
    terms = draw(st.dictionaries(NAMES, RETURNS, max_size=3))
    return EpisodeResult(
        draw(st.sampled_from(["a", "b"])), OWN["env"], draw(st.integers(0, 2**62)), OWN["seed"], draw(NAMES),
        draw(MAYBE_BOOL), draw(st.booleans()), draw(RETURNS), terms, 1 + len(times),
        draw(st.floats(1.0)), draw(NUMBERS), draw(METRICS), draw(st.integers(0, 2**40)),
        draw(st.integers(0, 2**40)), np.array([0.1, *times]), draw(NAMES),
    )  # fmt: skip


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(found=st.lists(results(), max_size=7, unique_by=lambda one: (one.policy, one.episode)))
def test_it_holds_what_was_written(found, tmp_path, monkeypatch):
    monkeypatch.setattr(rows_module, "AT_ONCE", 3)
    write(tmp_path, found)
    same(read_cell(tmp_path).episodes, found)


def test_the_same_command_plays_nothing_twice(folder):
    before = (folder / "episodes.csv").read_text()
    told = []
    again = run(folder, progress=told.append)
    assert again.resumed == len(told) == 6
    assert (folder / "episodes.csv").read_text() == before  # times included: nothing was played
    assert json.loads((folder / "summary.json").read_text())["policies"][1]["decision_ms_p50"] > 0


def test_what_is_missing_is_played_and_put_in_its_place(folder, finished):
    before = (folder / "episodes.csv").read_text().splitlines()
    edit(folder, "DELETE FROM episode WHERE episode != 2 OR policy != 0")
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
    pd.testing.assert_frame_equal(
        found.episodes.drop(columns=list(TIME_COLUMNS)),
        read_comparison(finished).episodes.drop(columns=list(TIME_COLUMNS)),
    )


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("UPDATE episode SET energy = energy + 1e-9 WHERE rowid = 3", "an episode was changed"),
        ("UPDATE episode SET contacts = NULL WHERE rowid = 1", "an episode was changed"),
        ("UPDATE episode SET feasible = 1 - feasible WHERE rowid = 2", "an episode was changed"),
        ("UPDATE episode SET policy = outcome, episode = 77 WHERE rowid = 1", "an episode was changed"),
        ("UPDATE episode SET episode = 99 WHERE rowid = 1", "an episode was changed"),
        ("UPDATE episode SET decision_ms = zeroblob(length(decision_ms)) WHERE rowid = 4", "an episode was changed"),
        ("UPDATE episode SET decision_ms = x'00' WHERE rowid = 4", "an episode was changed"),
        ("UPDATE episode SET reward_terms = x'' WHERE rowid = 4", "an episode was changed"),
        ("UPDATE episode SET run = 10000", "is out of bounds"),
        ("UPDATE episode SET run = -1", "a text that is not there"),
        ("UPDATE episode SET cell = 1 WHERE rowid = 4", "1 episodes that are not of its cells"),
        ("UPDATE text SET text = text || 'x' WHERE id = 0", "an episode was changed"),
        ("UPDATE text SET id = 99 WHERE id = 0", "not numbered"),
        ("UPDATE cell SET identity = replace(identity, ': 3', ': 4')", "checksum"),
        ("UPDATE cell SET identity = '[]'", "checksum"),
        ("DELETE FROM cell", "24 episodes that are not of its cells"),
        ("INSERT INTO run VALUES (0, '{}')", "checksum"),
        (f"INSERT INTO run VALUES (0, '{sealed({'id': 1})}')", "validation errors"),
        ("CREATE TABLE more (x)", "does not have the tables"),
        ("CREATE TRIGGER late AFTER DELETE ON run BEGIN DELETE FROM episode; END", "does not have the tables"),
        ("CREATE VIEW extra AS SELECT * FROM episode", "does not have the tables"),
        ("ALTER TABLE episode DROP COLUMN energy", "does not have the tables"),
        (f"PRAGMA user_version = {FORMAT + 1}", f"format {FORMAT + 1}"),
    ],
)
def test_what_another_program_changed_is_told_and_nothing_is_touched(made_up, command, says):
    edit(made_up, command)
    before = contents(made_up)
    for use in (read_store, resume):
        with pytest.raises(ResultsError, match=rf"results\.sqlite is damaged .*{says}"):
            use(made_up)
    assert contents(made_up) == before
    write(made_up, [])


def test_values_of_other_types_are_told(made_up):
    """As only somebody can write them who changes the tables and changes them back."""
    edit(made_up, *as_strict("replace(sql, ' STRICT', '')"))
    edit(made_up, "UPDATE episode SET energy = 'much' WHERE rowid = 1")
    edit(made_up, *as_strict("sql || ' STRICT'"))
    with pytest.raises(ResultsError, match=r"non-REAL value in episode\.energy"):
        read_store(made_up)


def as_strict(sql):
    change = f"UPDATE sqlite_schema SET sql = {sql} WHERE name = 'episode'"
    return "PRAGMA writable_schema = ON", change, "PRAGMA writable_schema = RESET"


def test_any_bytes_are_refused_or_change_nothing(made_up):
    whole, rng, refused = (made_up / STORE).read_bytes(), np.random.default_rng(0), 0
    contents = [b"", b"SQLite format 3\0", *(whole[:end] for end in range(1, len(whole), 2_003))]
    places = rng.integers(0, len(whole), 200).tolist()
    contents += [whole[:at] + bytes([whole[at] ^ int(rng.integers(1, 256))]) + whole[at + 1 :] for at in places]
    for content in contents:
        (made_up / STORE).write_bytes(content)
        try:
            same(read_cell(made_up).episodes, list(played(12, "ba")))
        except ResultsError as error:
            refused += "is damaged" in str(error)
    assert refused > 40


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"policy": "c"}, "not of this comparison"),
        ({"episode": -1}, "-1 is not the number"),
        *(({"total_reward": value}, "return has") for value in (math.inf, math.nan, 1e101, -1e308)),
        *(({"reward_terms": {"step": 0.0, "x": value}}, "reward_terms has") for value in (math.inf, math.nan, -1e101)),
        ({"decision_ms": np.array([math.nan, 1.0]), "length": 2}, "no times"),
        ({"decision_ms": np.array([1.0, -1.0]), "length": 2}, "no times"),
        ({"decision_ms": np.array([1.0, math.inf]), "length": 2}, "no times"),
        ({"decision_ms": np.array([]), "length": 0}, "without decision times"),
        ({"length": 99}, "do not fit the length"),
        ({"length": -1}, "do not fit the length"),
        ({"reset_ms": -1.0}, "reset_ms that is no time"),
    ],
)
def test_what_no_episode_can_be_is_told(tmp_path, change, says):
    """Though all checksums are right, as whoever means harm would write it."""
    found = list(played(12, "ba"))
    found[5] = replace(found[5], **change)
    write(tmp_path, found)
    with pytest.raises(ResultsError, match=says):
        read_store(tmp_path)


@pytest.mark.parametrize("identity", [{}, {"env": "x", "seed": 3}, {"env": 3, "seed": [], "policies": None}])
def test_an_identity_that_is_none_is_told(tmp_path, identity):
    write(tmp_path, [], OWN)
    edit(tmp_path, f"UPDATE cell SET identity = '{sealed(identity)}'")
    with pytest.raises(ResultsError, match="is damaged"):
        read_store(tmp_path)


def test_an_episode_has_one_row(made_up):
    with one_cell(made_up, OWN, 12) as store:
        store.write(next(played(1, "b")))
        with pytest.raises(ResultsError, match="UNIQUE"):
            store.finish({}, [])


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


WRITER = """
import sys
from pathlib import Path
from tests.made_up_episodes import OWN, played
from tests.stores import one_cell
with one_cell(Path(sys.argv[1]), OWN, 400) as store:
    known = {(one.policy, one.episode) for one in store.kept}
    for result in played(400, "ba"):
        if (result.policy, result.episode) not in known:
            store.write(result)
            print(result.policy, result.episode, flush=True)
    store.finish({}, [])
"""


@pytest.mark.parametrize(
    "kills", [1, pytest.param(3, marks=pytest.mark.slow), pytest.param(50, marks=pytest.mark.thorough)]
)
def test_a_kill_at_any_moment_loses_and_doubles_nothing(tmp_path, kills):
    """Of a process that only writes, so that it is killed within a transaction more often than not."""
    rng, written, results = random.Random(0), set(), {(one.policy, one.episode): one for one in played(400, "ba")}
    for _ in range(kills):
        command = [sys.executable, "-c", WRITER, str(tmp_path)]
        with subprocess.Popen(command, stdout=-1, text=True) as process:
            for _ in range(rng.randrange(1, 1 + 800 // kills)):
                written.add(process.stdout.readline())
            time.sleep(rng.choice([0.0, rng.uniform(0.0, 0.002)]))
            process.send_signal(signal.SIGKILL)
            written.update(process.stdout)
        stored = read_cell(tmp_path).episodes
        assert {f"{one.policy} {one.episode}\n" for one in stored} >= {line for line in written if line.endswith("\n")}
        same(list(stored), [results[one.policy, one.episode] for one in stored])


@pytest.mark.parametrize(("size", "kept"), [(0, False), (10_000, False), (40_000, True), (200_000, True)])
def test_a_full_disk_keeps_what_was_there(tmp_path, size, kept):
    found = list(played(400, "ba"))
    with full_disk(size), contextlib.suppress(ResultsError), one_cell(tmp_path, OWN, 400) as store:
        for result in found:
            store.write(result)
        same(store.episodes(), found)  # in memory
        with pytest.raises(ResultsError, match="could not be written any further"):
            store.finish({}, [])
    with one_cell(tmp_path, OWN, 400) as store:
        assert (len(store.kept) > 0) == kept
        same(store.kept, found[: len(store.kept)])
        for result in found[len(store.kept) :]:
            store.write(result)
        store.finish({}, [])
    same(read_cell(tmp_path).episodes, found)


def test_cells_share_a_file_and_nothing_else(tmp_path):
    """Episodes of the same numbers, in runs of the same id, of two cells that are written in turn."""
    found, other = list(played(12, "ba")), list(played(12, "ab"))
    with Store(tmp_path) as store:
        store.open(OWN["seed"], ["one", "other"])
        one, two = store.cell("one", OWN, 12), store.cell("other", OWN | {"env_options": {"x": 1}}, 12)
        for result, later in zip(found, other, strict=True):
            one.write(result)
            two.write(later)
        one.finish({"first": 1}, [], without=["a"])
    stored = read_store(tmp_path).cells
    same(stored["one"].episodes, [result for result in found if result.policy != "a"])
    same(stored["other"].episodes.sorted(["a", "b"]), other)
    assert (stored["one"].facts, stored["other"].facts) == ({"first": 1}, None)
    edit(tmp_path, "UPDATE episode SET cell = 0 WHERE rowid = 2")
    with pytest.raises(ResultsError, match="was changed, or belongs to another comparison"):
        read_store(tmp_path)


STILL = """
import helper

def still(observation):
    return observation[3:9] * helper.GAIN
"""


@pytest.mark.slow
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

"""Comparisons that end as a Parquet file: the same episodes, and nothing that is finished is lost."""

import importlib
import os
import shutil
from pathlib import Path

import pandas as pd
import pytest

from armctl.core.errors import ConfigurationError, ResultsError
from armctl.core.files import unsealed
from armctl.episodes import parquet_files as episodes_parquet
from armctl.episodes import store
from armctl.episodes.csv_files import Journal
from armctl.episodes.record import TIME_COLUMNS
from armctl.episodes.store import CSV, PARQUET, EpisodeLog, read_episodes
from armctl.episodes.table import EpisodeTable
from armctl.report import write_report
from armctl.rollout.real_time import read_recording
from armctl.study import compare, suite, sweep
from armctl.study.results import read_results

from ..command_line import armctl, program
from ..made_up_episodes import OWN, played, same

POLICIES = ["random", "reach_ik"]
OPTIONS = {"max_episode_steps": 5}
TABLES = {"episodes.csv", "decisions.csv"}


def run(out, episodes=3, **arguments):
    return compare(POLICIES, **{"episodes": episodes, "out": out, "env_options": OPTIONS, "store": PARQUET} | arguments)


def episodes_in(folder):
    return read_episodes(folder, unsealed((folder / "comparison.json").read_text()))


def timeless(folder):
    return episodes_in(folder).frame().drop(columns=list(TIME_COLUMNS))


def files(folder):
    return {path.name for path in folder.iterdir()} - {".lock", "comparison.json", "runs.json", "summary.json"}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    run(folder)
    return folder


@pytest.fixture
def folder(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "results")


@pytest.fixture
def small_parts(monkeypatch):
    monkeypatch.setattr(store, "ROWS", 4)
    monkeypatch.setattr(episodes_parquet, "ROWS", 3)


def test_a_file_takes_the_place_of_both_tables(finished):
    assert files(finished) == {"episodes.parquet"}
    frame = pd.read_parquet(finished / "episodes.parquet")
    assert list(zip(frame.policy, frame.episode, strict=True)) == [(name, k) for name in POLICIES for k in range(3)]


def test_the_episodes_are_those_of_the_tables(tmp_path, small_parts):
    told = {}
    for name, arguments in {"csv": {"store": CSV}, "one": {}, "two": {"workers": 2, "worlds": 2}}.items():
        run(tmp_path / name, episodes=7, **arguments)
        found = read_results(tmp_path / name).comparison
        told[name] = [(one.success, one.episode_return, one.length) for one in found.policies], found.paired
    pd.testing.assert_frame_equal(timeless(tmp_path / "one"), timeless(tmp_path / "csv"))
    pd.testing.assert_frame_equal(timeless(tmp_path / "two"), timeless(tmp_path / "csv"))
    assert told["one"][0] == told["two"][0] == told["csv"][0]


def test_what_is_converted_is_the_same(folder):
    before = episodes_in(folder)
    for kind, holds in ((CSV, TABLES), (PARQUET, {"episodes.parquet"}), (CSV, TABLES)):
        assert run(folder, store=kind).resumed == 6
        assert files(folder) == holds
        same(episodes_in(folder), before)


def test_more_episodes_go_on_from_fewer(folder, small_parts):
    before = episodes_in(folder)
    assert run(folder, episodes=9).resumed == 6
    after = episodes_in(folder)
    same(after[after.column("episode") < 3], before)
    assert len(after) == 18
    with pytest.raises(ResultsError, match="beyond the 3 asked for"):
        run(folder)


def test_reports_and_recorded_times_are_read_from_it(folder):
    write_report(folder, video=False)
    assert "reach_ik" in (folder / "report.html").read_text()
    assert set(read_recording(folder, 1.0, "armctl/ArmReach-v0", 0).recorded) == set(POLICIES)


def test_a_kill_at_any_moment_loses_and_doubles_nothing(tmp_path, monkeypatch, small_parts):
    """The folder as it is before each change to it, and between the two halves of one."""
    out, written, moments = tmp_path / "out", [], []

    def look():
        if out.exists():
            copy = tmp_path / f"moment-{len(moments)}"
            moments.append((shutil.copytree(out, copy), len(written)))

    def watched(kind, name):
        do = getattr(kind, name)

        def watched_do(*arguments, **named):
            look()
            return do(*arguments, **named)

        monkeypatch.setattr(kind, name, watched_do)

    for kind, name in ((Path, "replace"), (Path, "unlink"), (Journal, "_write"), (Journal, "restart")):
        watched(kind, name)
    results = list(played(9, "ba"))
    for store_now, some in ((PARQUET, results[:11]), (PARQUET, results[11:15]), (CSV, []), (PARQUET, results[15:])):
        with EpisodeLog(out, OWN, 9, store=store_now) as log:
            for result in some:
                log.write(result)
                written.append(result)
                log.kept.append(result)
            log.finish(log.kept, {})
    look()
    monkeypatch.undo()
    assert len(moments) > 60
    for moment, count in moments:
        if files(moment) - {one for one in files(moment) if "unfinished" in one}:
            same(sorted(read_episodes(moment, OWN), key=place)[:count], sorted(results[:count], key=place))
            assert len(read_episodes(moment, OWN)) - count in (0, 1)  # the last may be written, and not counted yet
        with EpisodeLog(moment, OWN, 9, store=PARQUET) as log:
            assert len(log.kept) >= count
            for result in results[len(log.kept) :]:
                log.write(result)
            log.finish(results, {})
        assert files(moment) == {"episodes.parquet"}
        same(read_episodes(moment, OWN), results)


def place(result):
    return -ord(result.policy), result.episode


def test_a_journal_half_emptied_after_a_part_doubles_nothing(tmp_path, small_parts):
    results = list(played(4))
    with EpisodeLog(tmp_path, OWN, 4, store=PARQUET) as log:
        for result in results[:3]:
            log.write(result)
        before = {name: (tmp_path / name).read_bytes() for name in TABLES}
        log.write(results[3])
    assert "episodes-1.parquet" in files(tmp_path)
    for name in TABLES:
        for half in (b"", before[name][:9]):
            for other in TABLES:
                (tmp_path / other).write_bytes(half if other == name else before[other])
            same(read_episodes(tmp_path, OWN), results)


def test_an_episode_twice_in_a_file_is_told(folder):
    own = unsealed((folder / "comparison.json").read_text())
    found = list(episodes_in(folder))
    with EpisodeLog(folder, own, 3, store=PARQUET) as log:
        log.finish([*found, found[2]], {})
    with pytest.raises(ResultsError, match="second time"):
        episodes_in(folder)


def test_a_full_disk_keeps_what_was_there(tmp_path):
    command = ["compare", *POLICIES, "--episodes", "40", "--out", "out", "--set", "max_episode_steps=5"]
    full = program(*command, "--store", "parquet", cwd=tmp_path, check=False, disk=9_000)
    assert full.returncode in (1, 2)
    assert "Traceback" not in full.stderr
    assert not list((tmp_path / "out").glob("*unfinished*"))
    assert "could not be written any further (File too large)" in full.stdout + full.stderr
    kept = episodes_in(tmp_path / "out")
    assert len(kept)
    done = armctl(*command, "--store", "parquet", cwd=tmp_path)
    assert "out/episodes.parquet has every episode" in done.stdout
    assert f"{len(kept)} episodes were finished by an earlier run" in done.stdout
    assert len(episodes_in(tmp_path / "out")) == 80


@pytest.mark.parametrize("name", ["episodes.parquet", "episodes-1.parquet", "episodes.csv"])
def test_nothing_is_written_through_a_link(folder, tmp_path, name):
    victim = tmp_path / "victim"
    victim.write_bytes((folder / "episodes.parquet").read_bytes() if name.endswith("parquet") else b"")
    before = victim.read_bytes()
    (folder / name).unlink(missing_ok=True)
    (folder / name).symlink_to(victim)
    for arguments in ({}, {"overwrite": True}, {"overwrite": True, "seed": 1}):
        try:
            run(folder, **arguments)
        except ResultsError:
            assert not arguments
    assert victim.read_bytes() == before
    assert not any(path.is_symlink() for path in folder.iterdir())


def test_damage_is_told_and_nothing_is_touched(folder):
    path = folder / "episodes.parquet"
    for content in (b"", b"PAR1", path.read_bytes()[:-30]):
        path.write_bytes(content)
        before = {one.name: one.read_bytes() for one in folder.iterdir()}
        for use in (run, read_results):
            with pytest.raises(ResultsError, match=r"episodes\.parquet is damaged"):
                use(folder)
        assert {one.name: one.read_bytes() for one in folder.iterdir()} == before
    path.unlink()
    os.mkfifo(path)
    with pytest.raises(ResultsError, match="not a regular file"):
        run(folder)
    assert run(folder, overwrite=True).resumed == 0


def test_a_file_of_another_comparison_is_told(folder, tmp_path):
    run(tmp_path / "other", env_options=OPTIONS | {"tolerance": 0.2})
    shutil.copy(tmp_path / "other" / "episodes.parquet", folder)
    for use in (run, read_results):
        with pytest.raises(ResultsError, match="another comparison"):
            use(folder)


def test_sweeps_and_suites_pass_it_on(tmp_path, monkeypatch):
    swept = {
        kind: sweep(
            POLICIES, disturbances={"delay": [1]}, episodes=2, out=tmp_path / kind, env_options=OPTIONS, store=kind
        )
        for kind in (CSV, PARQUET)
    }
    pd.testing.assert_frame_equal(swept[CSV].points, swept[PARQUET].points)
    module = importlib.import_module("armctl.study.suite")
    monkeypatch.setattr(module, "line_up", lambda env: ("reach_ik",))
    found = suite(["armctl/ArmReach-v0"], quick=True, episodes=1, out=tmp_path / "suite", store=PARQUET)
    assert not found.problems
    folders = [tmp_path / PARQUET / one for one in ("none", "delay-1.0")]
    folders += [path.parent for path in (tmp_path / "suite").glob("*/*/comparison.json")]
    assert len(folders) == 5
    assert all(files(one) == {"episodes.parquet"} for one in folders)


def test_another_store_is_refused_at_once(tmp_path):
    for play in (compare, sweep):
        with pytest.raises(ConfigurationError, match=r"no store of episodes 'feather'.*csv, parquet"):
            play(POLICIES, out=tmp_path / "out", store="feather")
    with pytest.raises(ConfigurationError, match="no store"):
        suite(store="feather", out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_table_of_none_is_read_back(tmp_path):
    with EpisodeLog(tmp_path, OWN, 1, store=PARQUET) as log:
        log.finish(EpisodeTable(), {})
    assert files(tmp_path) == {"episodes.parquet"}
    assert len(read_episodes(tmp_path, OWN)) == 0

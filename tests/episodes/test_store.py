"""The store of a results folder: what is finished is never lost, doubled or mixed."""

import contextlib
import itertools
import math
import random
import signal
import subprocess
import sys
import time
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import armctl
from armctl.core.errors import ResultsError
from armctl.episodes import assembly, blocks, columns, database, packing, store
from armctl.episodes.metrics import Metrics
from armctl.episodes.record import EpisodeResult
from armctl.episodes.store import Store
from armctl.episodes.stored import read_store

from ..command_line import full_disk
from ..made_up_episodes import OWN, played, same
from ..stores import one_cell, read_cell
from .stored import edit, write

NUMBERS, RETURNS = (st.floats(*limits).map(lambda x: x + 0.0) for limits in ((), (-1e100, 1e100)))  # no -0.0
MAYBE_INT, MAYBE_BOOL = st.none() | st.integers(0, 2**40), st.none() | st.booleans()
NAMES = st.text(st.characters(codec="utf-8"), max_size=8)
KINDS: dict[Any, Any] = {int: st.integers(0, 2**40), float: NUMBERS}
METRICS = st.builds(
    Metrics,
    **{one.name: KINDS.get(one.type, MAYBE_INT) for one in fields(Metrics)},
)


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


@pytest.mark.slow
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    found=st.lists(results(), max_size=7, unique_by=lambda one: (one.policy, one.episode)),
    in_file=st.booleans(),
    in_block=st.integers(1, 8),
)
def test_it_holds_what_was_written(found, in_file, in_block, tmp_path, monkeypatch):
    monkeypatch.setattr(assembly, "ROWS_AT_ONCE", 3)
    monkeypatch.setattr(blocks, "EPISODES", in_block)
    monkeypatch.setattr(columns, "LARGE", 0 if in_file else columns.LARGE)
    write(tmp_path, found)
    stored = {(one.policy, one.episode): one for one in read_cell(tmp_path).episodes}
    same([stored.pop((one.policy, one.episode)) for one in found], found)
    assert not stored


def test_steps_without_a_decision_are_unknown_beside_a_long_one(tmp_path):
    """The long one makes ticks of four bytes of all, in which those of two have another number in place of NaN."""
    episodes = list(played(2))
    episodes[1] = replace(episodes[1], decision_ms=np.full(episodes[1].length, 7.0))
    assert np.isnan(episodes[0].decision_ms).any()
    write(tmp_path, episodes)
    same(read_cell(tmp_path).episodes, episodes)


WRITER = """
import sys
from pathlib import Path
from armctl.episodes import blocks
from tests.made_up_episodes import OWN, played
from tests.stores import one_cell
blocks.EPISODES = 7
with one_cell(Path(sys.argv[1]), OWN, 400) as store:
    known = {(one.policy, one.episode) for one in store.kept}
    for result in played(400, "ba"):
        if (result.policy, result.episode) not in known:
            store.write(result)
            print(result.policy, result.episode, flush=True)
    store.finish({}, [])
"""


@pytest.mark.slow
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
        stored = read_cell(tmp_path).episodes.sorted("ba")
        assert {f"{one.policy} {one.episode}\n" for one in stored} >= {line for line in written if line.endswith("\n")}
        same(list(stored), [results[one.policy, one.episode] for one in stored])


@pytest.mark.parametrize("in_block", [blocks.EPISODES, pytest.param(2, marks=pytest.mark.slow)])
def test_an_interrupt_at_any_moment_of_a_write_spoils_no_other_episode(tmp_path, in_block, monkeypatch):
    """Ctrl-C before the k-th instruction of a write, and then a whole write, for each k. All outcomes are new texts."""
    monkeypatch.setattr(blocks, "EPISODES", in_block)
    whole, interrupted = [], []
    results = (replace(result, outcome=f"outcome {result.episode}") for result in played(2_000))
    files = {module.__file__ for module in (store, packing, database, contextlib)}
    with one_cell(tmp_path, OWN) as writer:
        for k in itertools.count():
            interrupted.append(next(results))
            if not interrupts(k, files, writer.write, interrupted[-1]):
                break
            whole.append(next(results))
            writer.write(whole[-1])
        writer.finish({}, [])
    stored = {one.episode: one for one in read_cell(tmp_path).episodes}
    same([stored.pop(one.episode) for one in whole], whole)
    assert interrupted[-1].episode in stored
    same([one for one in interrupted if one.episode in stored], [*stored.values()])
    assert 0 < len(stored) < len(interrupted) / 2


def interrupts(count, files, call, *arguments):
    """Make a call and interrupt it before instruction `count` that it runs in some files; False if there are fewer."""
    left = count

    def trace(frame, event, _):
        nonlocal left
        if frame.f_code.co_filename not in files:
            return None
        frame.f_trace_opcodes = True
        if event == "opcode":
            left -= 1
            if left == -1:
                raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        call(*arguments)
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
    return False


@pytest.mark.slow
@pytest.mark.parametrize("in_block", [blocks.EPISODES, 50])
@pytest.mark.parametrize(("size", "kept"), [(0, False), (10_000, False), (60_000, True), (200_000, True)])
def test_a_full_disk_keeps_what_was_there(tmp_path, size, kept, in_block, monkeypatch):
    monkeypatch.setattr(blocks, "EPISODES", in_block)
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
    edit(tmp_path, "UPDATE episode_row SET cell = 0 WHERE rowid = 2")
    with pytest.raises(ResultsError, match="was changed, or belongs to another comparison"):
        read_store(tmp_path)


@pytest.mark.one_case
@pytest.mark.parametrize("name", ["a b", "#?%41&mode=ro", "\udcff", "é\n"])
def test_a_folder_of_any_name_holds_results(name, tmp_path):
    made = armctl.compare(["random"], episodes=2, out=tmp_path / name, env_options={"max_episode_steps": 2})
    assert len(read_store(tmp_path / name).cells["none"].episodes) == len(made.results) == 2

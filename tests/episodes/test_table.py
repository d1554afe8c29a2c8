"""Tables hold what the results hold, in little memory: what a million episodes take is what each of a few takes."""

import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from armctl.episodes import assembly, columns, rows
from armctl.episodes.columns import Ragged, TimeCounts, milliseconds
from armctl.episodes.table import EpisodeTable
from armctl.stats import intervals as statistics
from armctl.stats.intervals import (
    GROUPS,
    MAX_VALUES,
    RandomWeights,
    bounded_mean,
    grouped,
    random_weights,
    worst_decile,
)
from armctl.verdict.summary import summarise

from ..made_up_comparison import UNTRAINED_POLICY, facts_of
from ..made_up_episodes import OWN, played, same
from ..stores import one_cell, read_cell

BYTES = 1_000
"""That an episode of some 15 decisions may take while it is read and summarised. It takes 400."""


@pytest.fixture
def results():
    found = list(played(12, "ba"))
    odd = np.array([0.123456, math.nan, 1e6, 0.0])  # no whole number of 0.1 us, and too long for 32 bits
    found[3] = replace(found[3], length=4, decision_ms=odd, seed=2**70)
    return found


def test_a_table_is_a_sequence_of_the_results(results):
    table = EpisodeTable(results)
    assert len(table) == 24
    same(table, results)
    same([table[5], table[-1]], [results[5], results[-1]])
    same(table[4:9][1:3], results[5:7])
    same(table[table.won], [one for one in results if one.success])
    same(table.sorted(["a", "b"]), results[12:] + results[:12])
    parts = table.by_policy()
    assert list(parts) == ["b", "a"]
    same(parts["a"].together(parts["b"]), results[12:] + results[:12])
    assert list(EpisodeTable()) == []


def test_a_frame_is_that_of_the_rows(results):
    for some in (results, results[:1], [replace(one, success=True, seed=1) for one in results]):
        pd.testing.assert_frame_equal(EpisodeTable(some).frame(), pd.DataFrame([one.row() for one in some]))


def test_columns_are_those_of_the_results(results):
    table, part = EpisodeTable(results), EpisodeTable(results)[6:]
    assert table.column("episode").tolist() == [one.episode for one in results]
    assert part.column("contacts").tolist() == [one.metrics.contacts for one in results[6:]]
    warm = np.concatenate([one.warm_ms for one in results[6:]])
    assert part.warm_times().quantiles((0.1, 0.99)) == np.quantile(warm, (0.1, 0.99)).tolist()
    assert len(part.warm_times()) == len(warm)
    np.testing.assert_array_equal(part.optimality_gap, [one.optimality_gap for one in results[6:]])
    seconds = [float(np.nansum(one.decision_ms)) / 1e3 for one in results]
    np.testing.assert_allclose(table.decision_seconds(), seconds, rtol=1e-12)
    earned = part.reward_sums()
    for term in ("step", "goal"):
        assert sorted(earned[term]) == sorted(one.reward_terms[term] for one in results[6:] if term in one.reward_terms)
    changed = part.without("missed_deadlines", np.arange(len(part)) > 0)
    assert changed.column("missed_deadlines").tolist() == [results[6].metrics.missed_deadlines] + [None] * 17
    assert part.column("missed_deadlines").tolist() == [one.metrics.missed_deadlines for one in results[6:]]


def test_lists_of_numbers_are_taken_in_any_order():
    lists = Ragged.of(np.arange(6.0), [2, 0, 3, 1])
    taken = lists.take(np.array([3, 0, 1, 3]))
    assert [taken[i].tolist() for i in range(4)] == [[5.0], [0.0, 1.0], [], [5.0]]
    assert taken.lengths.tolist() == [1, 2, 0, 1]


@pytest.mark.parametrize("num_codes", [3, 50])
def test_codes_are_placed_as_they_first_occur(num_codes):
    for count in (0, 1, 20):
        codes = np.random.default_rng(0).integers(0, 3, count)
        firsts, places = columns.by_occurrence(codes, num_codes)
        order = list(dict.fromkeys(codes.tolist()))
        assert codes[firsts].tolist() == order
        assert firsts.tolist() == [codes.tolist().index(code) for code in order]
        assert places.tolist() == [order.index(code) for code in codes]


@pytest.mark.parametrize("kind", ["u2", "i4", "f8"])
def test_counted_times_have_the_quantiles_of_all_of_them(kind):
    rng = np.random.default_rng(0)
    for count in (0, 1, 2, 999):
        ms = np.where(rng.random(count) < 0.3, 1.0 if kind == "u2" else 200.0, 0.0) + rng.random(count).round(4)
        times = ms.round(4) if kind == "f8" else np.rint(1e4 * ms).astype(kind)
        counts, shares = TimeCounts(), (0.0, 0.01, 0.5, 0.99, 1.0)
        for part in np.array_split(times, 3):
            counts.add(part)
        ms = milliseconds(times) if count else np.array([math.nan])
        assert len(counts) == count
        np.testing.assert_array_equal(counts.quantiles(shares), np.quantile(ms, shares))
        np.testing.assert_array_equal(counts.quantiles(shares, 0.4), np.quantile(np.maximum(ms, 0.4), shares))
        np.testing.assert_array_equal(counts.median, np.median(ms))


def test_each_column_is_allocated_once(tmp_path, monkeypatch):
    """Not for every few rows: reading would take longer with the square of the episodes."""
    monkeypatch.setattr(assembly, "ROWS_AT_ONCE", 10)
    with one_cell(tmp_path, OWN, 500) as log:
        for result in played(500):
            log.write(result)
    sizes = []
    allocate = columns.Pages.array
    monkeypatch.setattr(
        columns.Pages, "array", lambda self, size, kind: sizes.append(size) or allocate(self, size, kind)
    )
    assert len(read_cell(tmp_path).episodes) == 500
    assert 0 < sizes.count(500) <= len(rows.COLUMNS)


@pytest.mark.slow
def test_memory_grows_little_with_the_episodes(tmp_path, monkeypatch):
    """By what is allocated, which is the same on each machine: between a small table and a larger one.

    Random weights and rows on their way into a table take a fixed amount, which is made so small that the rest is seen.
    """
    monkeypatch.setattr(statistics, "LARGEST_BATCH", 1)
    monkeypatch.setattr(statistics, "DRAWS", 50)
    monkeypatch.setattr(assembly, "ROWS_AT_ONCE", 200)
    policies = dict.fromkeys("ab", UNTRAINED_POLICY)
    peaks = []
    for episodes in (500, 2_500):
        folder = tmp_path / str(episodes)
        with one_cell(folder, OWN, episodes) as log:
            for result in played(episodes, policies):
                log.write(result)
        tracemalloc.start()
        results = read_cell(folder).episodes
        known = facts_of(policies=policies, planned=episodes, return_bounds=(-30.0, 1.0), time_limit=30)
        summarise(results.sorted(["a", "b"]), known)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert (peaks[1] - peaks[0]) / 4_000 < BYTES


@pytest.mark.slow
def test_the_intervals_of_very_many_values_are_those_of_each_with_a_weight_of_its_own():
    rng = np.random.default_rng(0)
    values = np.where(rng.random(3 * MAX_VALUES) < 0.01, -100.0, 80.0) + rng.standard_normal(3 * MAX_VALUES)
    ordered, counts = np.unique(values, return_counts=True)
    drawn, sizes = grouped(ordered, counts)
    assert len(drawn) <= GROUPS + 1
    assert sizes.sum() == len(values)
    assert drawn @ sizes / len(values) == pytest.approx(values.mean(), rel=1e-12)
    assert np.var(ordered) == pytest.approx(sizes @ (drawn - values.mean()) ** 2 / len(values), rel=1e-5)
    rows = [
        np.array([w @ ordered + p[:, 0] * -120, w @ ordered + p[:, 0] * 90]) for w, p in random_weights(counts, rng)
    ]
    exact, found = RandomWeights(*np.concatenate(rows, axis=1)).limits(), bounded_mean(values, (-120.0, 90.0))
    assert found.bounds == pytest.approx(exact, abs=0.1 * (exact[1] - exact[0]))
    assert found.value == pytest.approx(values.mean())
    worst = worst_decile(values, (-120.0, 90.0))
    assert worst.value == pytest.approx(np.sort(values)[: len(values) // 10].mean())
    assert worst.low < worst.value < worst.high

"""The simulated cluster agrees with what can be computed, and no unit is lost or counted twice."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

model = runpy.run_path(str(Path(__file__).parents[1] / "benchmarks" / "cluster_model.py"))
simulated, Costs = model["simulated"], model["Costs"]
DURATIONS = np.random.default_rng(0).exponential(1.0, 2000).tolist()


def test_one_worker_takes_the_sum_of_all_times():
    found = simulated(DURATIONS, 1, 1, Costs(start=7.0, work=0.5))
    assert found.seconds == pytest.approx(7.0 + sum(DURATIONS) + 0.5 * len(DURATIONS))


@pytest.mark.slow
@pytest.mark.parametrize("workers", [2, 10, 100])
def test_without_costs_all_workers_are_busy_to_the_end(workers):
    found = simulated(DURATIONS, 1, workers, Costs())
    assert sum(DURATIONS) / workers <= found.seconds <= sum(DURATIONS) / workers + max(DURATIONS)
    assert found.client_busy == 0


def test_a_slow_writer_sets_the_pace():
    costs = Costs(send=0.1, receive=0.2, write=0.3)
    found = simulated([0.01] * 500, 4, 100, costs)
    assert costs.limit(4) == pytest.approx(1 / 1.5)
    assert found.seconds == pytest.approx(500 * 1.5, rel=0.01)
    assert found.client_busy == pytest.approx(500 * 1.5)


def test_in_a_crowd_of_finished_units_each_is_paid_for_once():
    costs = Costs(receive=0.01, wait=0.001)
    found = simulated([0.0] * 5000, 1, 50, costs)
    assert 5000 / found.seconds == pytest.approx(costs.limit(1), rel=0.1)


def test_few_finished_units_cost_as_many_calls_as_many_do():
    """Each call costs for all that is under way."""
    costs = Costs(wait=0.001)
    one_by_one = simulated(np.arange(1.0, 101.0).tolist(), 1, 100, costs)
    assert one_by_one.client_busy == pytest.approx(0.001 * 100 * 101 / 2)
    at_once = simulated([1.0] * 100, 1, 100, costs)
    assert at_once.client_busy == pytest.approx(0.001 * 100)


def test_a_slow_scheduler_sets_the_pace():
    costs = Costs(schedule=0.5, receive=0.1)
    assert simulated([0.01] * 500, 1, 100, costs).seconds == pytest.approx(250, rel=0.01)
    assert costs.limit(1) == 2


@pytest.mark.parametrize("costs", [Costs(receive=0.02, write=0.005), Costs(send=0.01, wait=0.0001, work=0.3)])
def test_one_client_keeps_up_with_as_many_workers_as_computed(costs):
    """With half as many, they are busy; with twice as many, the client is."""
    enough = costs.saturated_by(1.0, 4)
    few, many = enough // 2, enough * 2
    busy = simulated([1.0] * 50 * few, 4, few, costs)
    assert 50 * (1.0 + costs.work) <= busy.seconds <= 1.1 * 50 * (1.0 + costs.work)
    late = simulated([1.0] * 50 * many, 4, many, costs)
    assert late.client_busy > 0.9 * late.seconds
    assert 50 * many / late.seconds == pytest.approx(costs.limit(4), rel=0.1)


def test_transport_is_hidden_by_the_units_that_wait_at_the_workers():
    quick, far = (simulated([1.0] * 400, 1, 4, Costs(transport=transport)).seconds for transport in (0.0, 0.8))
    assert far - quick == pytest.approx(0.8)
    assert simulated([1.0] * 400, 1, 4, Costs(transport=10.0)).seconds > 2 * quick


@given(workers=st.integers(1, 30), units=st.integers(0, 200), per_hour=st.floats(0, 400), seed=st.integers(0, 1000))
def test_each_unit_has_one_result_while_a_worker_is_left(workers, units, per_hour, seed):
    costs = Costs(start=1.0, send=0.01, schedule=0.01, transport=0.1, receive=0.01)
    found = simulated(DURATIONS[:units], 1, workers, costs, per_hour / 3600, np.random.default_rng(seed))
    assert len(found.results) == len(set(found.results)) <= units
    assert found.lost <= workers
    assert found.again <= found.lost
    if found.lost < workers:
        assert sorted(found.results) == list(range(units))
    if not found.lost:
        assert found.again == found.wasted == 0


@pytest.mark.slow
def test_workers_are_lost_at_the_rate_that_was_asked_for():
    hour = simulated([60.0] * 60 * 1000, 1, 1000, Costs(), 0.05 / 3600, np.random.default_rng(1))
    assert 30 < hour.lost < 75
    assert hour.wasted < 60 * hour.lost
    assert 3600 < hour.seconds < 1.1 * 3600
    assert sorted(hour.results) == list(range(60 * 1000))


def test_the_best_block_is_neither_the_smallest_nor_the_largest():
    """Small blocks cost the client, and large ones leave workers idle at the end."""
    costs = replace(Costs(), send=0.002, receive=0.002)
    seconds = {block: simulated([0.05 * block] * (8192 // block), block, 64, costs).seconds for block in (1, 16, 1024)}
    assert seconds[16] < min(seconds[1], seconds[1024])

"""The figures of a summary are those of the rows that it summarises."""

import dataclasses
import math

import numpy as np
import pytest

import armctl
from armctl.stats.intervals import bounded_mean, success_rate, worst_decile
from armctl.stats.trainings import mean_over_trainings
from armctl.verdict.scores import WITHIN_RANGE, WITHIN_SPEED

from .made_up_verdicts import summary_of

LIMIT = 100


@pytest.fixture(scope="module")
def comparison():
    return armctl.compare(["reach_ppo", "random", "reach_bc[*]"], episodes=12, worlds=1)


def rows_of(comparison, policy):
    return comparison.episodes[comparison.episodes.policy == policy].sort_values("episode")


def clean(rows):
    return rows.success & (rows.contacts == 0) & (rows.range_use <= WITHIN_RANGE) & (rows.speed_use <= WITHIN_SPEED)


@pytest.mark.parametrize("policy", ["reach_ppo", "random"])
def test_each_figure_is_that_of_its_column(comparison, policy):
    rows, found = rows_of(comparison, policy), next(one for one in comparison.policies if one.policy == policy)
    won = rows.success.to_numpy(bool)
    steps = np.where(won, rows.length, LIMIT).astype(float)
    assert found.success == success_rate(won)
    assert found.restricted_steps == bounded_mean(steps, (1.0, LIMIT))
    assert found.length == bounded_mean(rows.length.to_numpy(float), (1.0, LIMIT))
    efficiency = won * rows.lower_bound_steps / np.maximum(rows.length, rows.lower_bound_steps)
    assert found.efficiency == bounded_mean(efficiency.to_numpy(float), (0.0, 1.0))
    returns = rows["return"].to_numpy(float)
    bounds = (-LIMIT * 1.0, 99.0)
    assert (found.episode_return, found.worst_decile) == (bounded_mean(returns, bounds), worst_decile(returns, bounds))
    assert found.clean_success.value == pytest.approx(clean(rows).mean())
    assert found.reset_ms == pytest.approx(rows.reset_ms.median())
    assert found.first_call_ms == pytest.approx(np.nanmax(rows.first_call_ms))
    contacts = (rows[rows.success] if won.any() else rows[:0]).contacts.to_numpy(float)
    assert found.metrics["contacts"] == bounded_mean(contacts, (0.0, LIMIT))


def test_figures_of_a_group_are_over_its_trainings(comparison):
    found = next(one for one in comparison.policies if one.trainings)
    by_training = [rows_of(comparison, name) for name in found.trainings]
    for name, bounds, values in (
        ("clean_success", (0.0, 1.0), [clean(rows) for rows in by_training]),
        ("restricted_steps", (1.0, LIMIT), [rows.length.where(rows.success, LIMIT) for rows in by_training]),
    ):
        assert getattr(found, name) == mean_over_trainings(np.array(values, dtype=float), bounds).mean


def test_filters_processes_of_policies_and_unknown_times_are_told():
    plain = summary_of("mine", np.ones(4, dtype=bool))
    filtered = dataclasses.replace(plain, intervention_share=0.0213, intervention_size=0.05)
    assert filtered.interventions == [
        "safety filter: action changed in 2.1 % of the control steps, by 5 % of its range"
    ]
    (apart,) = dataclasses.replace(plain, isolated=True, transport_ms=0.31).isolation
    assert apart == "isolated: decision times as measured in its own process, without 0.31 ms of transport"
    assert (plain.interventions, dataclasses.replace(plain, isolated=False).isolation) == ([], [])
    rounded = dataclasses.replace(plain, decision_ms_p99=math.nan)
    assert (rounded.decision_time, plain.decision_time) == ("0.25 ms", "0.25 ms (99th percentile 0.5 ms)")
    assert dataclasses.replace(plain, decision_ms_p50=math.nan).decision_time == "unknown"

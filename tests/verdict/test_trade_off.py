"""The Pareto front of success and decision time, and where training breaks even."""

import dataclasses
import itertools
import math

import numpy as np
import pandas as pd
import pytest

from armctl.agents.costs import TrainingCost
from armctl.report.cost_figures import trade_off, training_cost
from armctl.report.style import styles_of
from armctl.stats.intervals import Estimate
from armctl.study.curves import COSTS, CURVE_COLUMNS, read_curve
from armctl.verdict.summary import PolicySummary
from armctl.verdict.trade_off import Point, break_evens, cost_curve, pareto_front, points


def policy(name, success, cost=None, ms=1.0, **more):
    values = {field.name: None for field in dataclasses.fields(PolicySummary)}
    known = {
        "policy": name, "sees": "observation", "training": cost or TrainingCost(), "decision_ms_p50": ms,
        "control_step_ms": ms,
        "decision_ms_p99": 2 * ms, "success": Estimate(success, success - 0.1, success + 0.1),
        "worlds": 1, "workers": 1,
    }  # fmt: skip
    return PolicySummary(**values | known | more)


def curve(*successes, decisions=None):
    steps = 100.0 * np.arange(len(successes))
    table = pd.DataFrame({"steps": steps, "success": successes})
    table = table.assign(low=table.success - 0.1, high=table.success + 0.1)
    return table.assign(decisions=math.nan if decisions is None else decisions)


def test_the_front_is_what_nobody_beats():
    rng = np.random.default_rng(0)
    for _ in range(50):
        drawn = rng.integers(1, 6, (8, 2))
        found = [
            Point(str(i), Estimate(float(score), None, None), float(ms), 9.0) for i, (score, ms) in enumerate(drawn)
        ]
        front = pareto_front(found)

        def beats(a, b):
            gains = (a.score.value - b.score.value, b.decision_ms - a.decision_ms)
            return min(gains) >= 0 and max(gains) > 0

        assert not any(beats(a, b) for a, b in itertools.product(found, front))
        for one in found:
            alike = [(b.score.value, b.decision_ms) for b in front]
            assert any(beats(b, one) for b in front) or (one.score.value, one.decision_ms) in alike
        times = [one.decision_ms for one in front]
        assert times == sorted(times)


def test_random_actions_are_no_part_of_the_front_but_alone():
    cheap, good = (
        Point("random", Estimate(0.02, None, None), 0.01, 0.02),
        Point("ik", Estimate(1.0, None, None), 1.0, 2.0),
    )
    assert pareto_front([cheap, good]) == [good]
    assert pareto_front([cheap]) == [cheap]


def test_a_dot_is_at_the_time_of_a_control_step_whenever_a_policy_plans():
    fast, planner, none = (
        policy("a", 0.5, ms=0.1),
        policy("b", 0.5, ms=0.1, control_step_ms=2.1),
        policy("c", 0.5, ms=math.nan),
    )
    assert [one.decision_ms for one in points([fast, planner, none])] == [0.1, 2.1]


def test_times_that_were_taken_differently_have_no_points():
    alike = [policy("a", 0.5), policy("b", 0.6, ms=2.0)]
    assert [(one.label, one.decision_ms, one.slow_ms) for one in points(alike)] == [("a", 1.0, 2.0), ("b", 2.0, 4.0)]
    assert points([policy("a", 0.5), policy("b", 0.6, worlds=10)]) == []


PPO = TrainingCost(400, None, 400)


@pytest.mark.parametrize(
    ("successes", "says"),
    [
        (
            (0.0, 0.5, 0.9, 0.85),
            "ppo reaches the 90.0 % of ik after 200 decisions: 90.0 % [80.0, 100.0].",
        ),
        (
            (0.0, 0.5, 0.8, 0.7),
            "ppo does not reach the 90.0 % of ik: its best in 300 decisions of training is 80.0 % [70.0, 90.0].",
        ),
    ],
)
def test_break_even_is_the_first_cost_at_which_the_best_expert_is_reached(successes, says):
    policies = [policy("worse", 0.4), policy("ik", 0.9), policy("ppo", 0.95, PPO), policy("old", 0.95, TrainingCost(9))]
    (found,) = break_evens(policies, {"ppo": curve(*successes), "old": curve(0.5, 0.9)})
    assert str(found) == says
    assert break_evens(policies[2:], {"ppo": curve(*successes)}) == []


def test_steps_of_a_curve_are_decisions_only_if_the_card_says_so():
    old = curve(0.1, 0.5, 0.9)
    assert cost_curve(policy("ppo", 0.9, PPO), old).decisions.tolist() == [100, 200]
    clone = TrainingCost(400, None, None, None, 400)
    assert cost_curve(policy("bc", 0.9, clone), old).empty
    counted = curve(0.1, 0.5, 0.9, decisions=[50, 70, 90])
    assert cost_curve(policy("dagger", 0.9, clone), counted).decisions.tolist() == [50, 70, 90]
    demonstrated = cost_curve(policy("bc", 0.8, TrainingCost(400, None, 70)), curve(0.1, 0.5, decisions=70.0))
    assert demonstrated[["decisions", "success"]].values.tolist() == [[70, 0.8]]


@pytest.mark.parametrize("spoilt", [math.inf, -1.0, 0.0, math.nan])
def test_odd_numbers_of_decisions_are_not_drawn(spoilt):
    agent, table = policy("ppo", 0.9, TrainingCost(5)), curve(0.1, 0.5, 0.9, decisions=[10.0, spoilt, 30.0])
    known = cost_curve(agent, table)
    assert known.decisions.tolist() == [10, 30]
    figure = training_cost({"ppo": known}, [agent], [], styles_of(["ppo"]))
    assert all(math.isfinite(end) for end in figure.layout.xaxis.range)


@pytest.mark.parametrize("cell", ["1" + "0" * 400, "1e999"])
def test_a_number_that_is_too_large_is_infinite(tmp_path, cell):
    columns = (*CURVE_COLUMNS, *COSTS)
    (tmp_path / "curve.csv").write_text(f"{','.join(columns)}\n{','.join([cell] * len(columns))}\n")
    assert np.isinf(read_curve(tmp_path / "curve.csv").to_numpy()).all()


def test_the_picture_holds_the_points_and_their_front():
    found = points([policy("a", 0.5, ms=0.1), policy("b", 0.9, ms=5.0), policy("c", 0.4, ms=1.0)])
    figure = trade_off(found, styles_of(["a", "b", "c"]))
    dots = {trace.name: (trace.x[0], trace.y[0]) for trace in figure.data if trace.name}
    assert dots == {"a": (0.1, 0.5), "b": (5.0, 0.9), "c": (1.0, 0.4)}
    assert list(figure.data[0].y) == [0.5, 0.9, 0.9]
    assert figure.layout.xaxis.type == "log"

import gymnasium
import numpy as np
import pytest

from armctl.control.drive_mpc import DriveMpc
from armctl.core.errors import ConfigurationError
from armctl.policies import make_policy
from armctl.rollout import evaluate

from ..stores import timeless
from .driving import FAST, MOVING, STATIC, check_distances


@pytest.mark.slow
@pytest.mark.parametrize("env", [STATIC, MOVING])
def test_it_crosses_nearly_always_and_decides_in_time(env, sized):
    results = evaluate("bridge_mpc", env, episodes=sized(2, 6), seed=0, worlds=1, env_options=FAST)
    assert results.success.mean() >= 0.97
    assert results.length[results.success].mean() < 105
    assert results.decision_ms_p50.median() < 100


@pytest.mark.slow
def test_it_crosses_other_bridges():
    options = {**FAST, "deck_length": 12.0, "deck_width": 4.6, "blocks": 1, "walkers": 2}
    assert evaluate("bridge_mpc", MOVING, episodes=4, seed=5, worlds=4, env_options=options).success.all()


@pytest.mark.slow
def test_it_is_the_same_in_every_run_and_needs_no_camera():
    short = {"deck_length": 11.0, "blocks": 2, "walkers": 2}
    runs = [
        evaluate("bridge_mpc", MOVING, episodes=2, seed=2, worlds=worlds, env_options={**short, **options})
        for worlds, options in ((2, FAST), (1, {"resolution": (6, 4)}))
    ]
    first, second = (timeless(run) for run in runs)
    assert first.equals(second)


@pytest.mark.slow
def test_it_keeps_its_distance_and_always_has_a_solution(monkeypatch):
    results, decide = [], DriveMpc.decide
    monkeypatch.setattr(DriveMpc, "decide", lambda *told: results.append(decide(*told)) or results[-1])
    check_distances("bridge_mpc", n=3, decisions=130, to_obstacles=0.31, to_people=0.31)
    assert np.mean([result.solved for result in results]) > 0.99


@pytest.mark.slow
@pytest.mark.parametrize(("disturbances", "least"), [({"payload": 40.0}, 0.8), ({"strength": 0.2}, 0.3)])
def test_rovers_that_hardly_turn_cross(disturbances, least):
    options = {**FAST, "disturbances": disturbances}
    results = evaluate("bridge_mpc", STATIC, episodes=5, seed=100, worlds=5, env_options=options)
    assert results.success.mean() >= least


def test_it_refuses_other_tasks():
    with pytest.raises(ConfigurationError, match="BridgeCross"):
        make_policy("bridge_mpc", gymnasium.make("armctl/ArmReach-v0"))

"""A short soak with hostile actions; `benchmarks/soak.py` makes the long one."""

import runpy
from pathlib import Path

import pytest

soak = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks" / "soak.py"), run_name="soak")
CASES = [(env, control) for env, (*_, controls) in soak["ENVIRONMENTS"].items() for control in controls]


def check(env, control, steps, levels, label):
    for row in soak["soak"](env, control, steps, 20, 1, levels, label):
        assert (row.not_finite, row.silent_resets, row.unstable) == (0, 0, 0), row
        if not levels:
            assert row.limit_excess <= 0.02, row
            assert row.penetration <= 0.005, row
            assert row.speed_ratio <= 2, row


SHORT = [("ArmReach-v0", "position"), ("ArmReach-v0", "torque"), ("BridgeCross-v0", "velocity")]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env", "control"),
    [*SHORT, *(pytest.param(*case, marks=pytest.mark.thorough) for case in CASES if case not in SHORT)],
)
def test_hostile_actions_keep_within_bounds(env, control):
    check(env, control, 1000, {}, "none")


@pytest.mark.slow
@pytest.mark.parametrize("env", ["ArmReach-v0", "BridgeCross-v0"])
def test_all_disturbances_at_their_strongest_are_stable(env):
    levels = soak["highest_levels"](env) | {"strength": 1.0}
    check(env, "torque" if env == "ArmReach-v0" else "velocity", 750, levels, "all")


def test_the_meter_sees_what_it_should():
    made = soak["TaskVectorEnv"](2, task=soak["_Reach"], control="velocity", threads=1)
    meter = soak["Meter"](made.task)
    made.reset(seed=0)
    made.task.simulation.array("qvel")[1, 3] = 1.3 * made.task.arm.description.limits.velocity[3]
    made.task.simulation.array("qpos")[1, 4] = made.task.arm.description.limits.upper[4] + 0.005
    made.step(made.action_space.sample() * 0)
    assert meter.speed_ratio[1] > 1.2 > 0.1 > meter.speed_ratio[0]
    assert meter.limit_excess[1] > 0.004 > meter.limit_excess[0]
    made.task.simulation.array("qpos")[0] = [0, 1.2, 0.5, 0, 0, 0]
    made.step(made.action_space.sample() * 0)
    assert meter.penetration[0] > 0.05 > meter.penetration[1]

"""Plans: all that can be wrong with a study is told before anything is played."""

import pytest

from armctl.core.errors import ConfigurationError
from armctl.rollout.real_time import RealTime
from armctl.study import compare, suite, sweep
from armctl.study.names import FROM_UNDISTURBED
from armctl.study.options import TaskOptions
from armctl.study.plan import comparison_plan, sweep_plan

REACH = "armctl/ArmReach-v0"


def test_a_comparison_is_one_cell():
    plan = comparison_plan(["reach_ik", "reach_bc[*]"], REACH, 7, 3, {"env_options": {"robot": "ur10"}, "worlds": 2})
    (cell,) = plan.cells
    assert (cell.name, cell.env, cell.env_options) == ("none", REACH, {"robot": "ur10"})
    assert list(cell.players) == ["reach_ik", "reach_bc[0]", "reach_bc[1]", "reach_bc[2]"]
    assert cell.groups == {"reach_bc[*]": ["reach_bc[0]", "reach_bc[1]", "reach_bc[2]"]}
    assert (plan.total, plan.num_envs) == (7 * 4, 2)


def test_a_sweep_has_a_cell_for_each_level_and_the_undisturbed_one_first():
    options: TaskOptions = {"env_options": {"disturbances": {"strength": 0.9}, "tolerance": 0.03}}
    plan = sweep_plan(["random"], REACH, {"delay": [2, 1], "slow-down": [5]}, 4, 0, options)
    assert [cell.name for cell in plan.cells] == ["none", "delay-1.0", "delay-2.0", "slow-down-5.0"]
    none, first, _, slow = plan.cells
    assert none.env_options == slow.env_options == options["env_options"]
    assert first.env_options == {"tolerance": 0.03, "disturbances": {"strength": 0.9, "delay": 1.0}}
    assert (slow.repeats, slow.real_time) == ("none", RealTime(slow_down=5.0, latency=FROM_UNDISTURBED))
    assert plan.tasks[0].recorded == FROM_UNDISTURBED


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"baseline": "reach_ki"}, "Did you mean 'reach_ik'"),
        ({"margin": 1.5}, "between 0 and 1"),
        ({"slow_down": 2.0}, "slow_down is for real time"),
        ({"real_time": "measured", "worlds": 2}, "one world and one worker"),
        ({"episodes": 0}, "episodes"),
        ({"worlds": 0}, "worlds"),
        ({"seed": 2**32 + 5}, "seed"),
        ({"wrokers": 2}, "Did you mean 'workers'"),
        ({"disturbances": ["noise"]}, "no option 'disturbances'"),
    ],
)
def test_what_is_wrong_with_a_comparison_is_told_before_a_folder_is_made(arguments, says, tmp_path):
    with pytest.raises(ConfigurationError, match=says):
        compare(["reach_ik", "random"], **{"episodes": 2, "out": tmp_path / "out"} | arguments)
    assert not (tmp_path / "out").exists()


def test_sweeps_and_suites_have_options_of_their_own(tmp_path):
    with pytest.raises(ConfigurationError, match="no option 'margin'"):
        sweep("random", margin=0.1)  # type: ignore[call-arg]
    with pytest.raises(ConfigurationError, match="no option 'env_options'"):
        suite([REACH], env_options={})  # type: ignore[call-arg]

"""Two disturbances at once: which cells are played, what they have in common with others, and what is refused."""

import pandas as pd
import pytest

from armctl.core.errors import ConfigurationError
from armctl.report import write_report
from armctl.study import compare, sweep
from armctl.study.grid import Grid
from armctl.study.grids import checked_grids
from armctl.study.levels import disturbance_specs
from armctl.study.plan import sweep_plan
from armctl.study.results import read_study
from armctl.study.task_results import PAIR_COLUMNS

from ..report.pages import text_of
from ..stores import timeless

POLICIES = ["reach_ik", "random"]
REACH = "armctl/ArmReach-v0"
PAIRS = [{"delay": [2], "payload": [5, 20]}]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs")
    return sweep(POLICIES, pairs=PAIRS, disturbances={"payload": [20]}, episodes=3, seed=3, out=folder), folder


@pytest.mark.slow
def test_each_cell_is_a_comparison_with_both_disturbances(finished):
    result, _ = finished
    assert list(result.comparisons) == ["none", "payload-20.0", "delay-2.0+payload-5.0", "delay-2.0+payload-20.0"]
    single = compare(POLICIES, episodes=3, seed=3, env_options={"disturbances": {"delay": 2, "payload": 20}})
    cell = result.comparisons["delay-2.0+payload-20.0"].episodes
    pd.testing.assert_frame_equal(timeless(single.episodes), timeless(cell))


def test_a_map_has_the_cells_of_single_disturbances_that_were_played(finished):
    result, folder = finished
    (grid_map,) = result.maps
    assert grid_map.grid == Grid("delay", "payload", [0.0, 2.0], [0.0, 5.0, 20.0])
    rates = {policy: [cell.policies[i].success.value for cell in result.comparisons.values()] for i, policy in
             enumerate(POLICIES)}  # fmt: skip
    for policy in POLICIES:
        none, heavy, *both = rates[policy]
        expected = [[f"{100 * none:.0f}", "-", f"{100 * heavy:.0f}"], ["-", *(f"{100 * rate:.0f}" for rate in both)]]
        assert grid_map.texts(policy) == expected
    stored = pd.read_csv(folder / "pairs.csv")
    assert tuple(stored.columns[: len(PAIR_COLUMNS)]) == PAIR_COLUMNS
    assert len(stored) == 2 * len(result.comparisons)


def test_they_are_read_back_and_reported(finished):
    result, folder = finished
    (again,) = read_study(folder).tasks.values()
    assert again.grids == result.grids
    assert [table.rows for table in again.document().tables] == [table.rows for table in result.document().tables]
    text = text_of(write_report(folder, video=False))
    assert "Two disturbances at once" in text
    assert "--pairs delay=2,payload=5,20" in text


def test_asked_again_nothing_is_played(finished):
    _, folder = finished
    before = (folder / "episodes.csv").read_text()
    sweep(POLICIES, pairs=[{"payload": [5, 20], "delay": [2]}], disturbances={"payload": [20]}, episodes=3, seed=3,
          out=folder)  # fmt: skip
    assert (folder / "episodes.csv").read_text() == before


@pytest.mark.slow
def test_leaders_are_those_of_the_cells_tests():
    result = sweep(POLICIES, pairs=PAIRS, episodes=12, worlds=12, seed=3)
    (grid_map,) = result.maps
    assert grid_map.start == 1
    leader = grid_map.leaders[1][1]
    assert (leader.policy, leader.certain, leader.not_worse) == ("reach_ik", True, [])
    assert "reach_ik leads in" in " ".join(part.text for part in result.document().parts if hasattr(part, "text"))


@pytest.mark.slow
def test_default_pairs_have_three_levels_each():
    plan = sweep_plan(POLICIES, REACH, None, 1, 0, {}, "default")
    (task,) = plan.tasks
    assert [grid.name for grid in task.grids] == ["noise x delay", "payload x friction", "noise x mismatch"]
    assert len(task.cells) == 1 + 3 * 9
    assert task.grids[0].column_levels == [0, 1, 4, 8]
    bridge = checked_grids(disturbance_specs("armctl/BridgeCross-v0", {}), "default")
    assert {name for grid in bridge for name in (grid.rows, grid.columns)} == {
        "noise_on_state", "delay", "payload", "friction", "mismatch"
    }  # fmt: skip


@pytest.mark.parametrize(
    ("pairs", "why"),
    [
        ("all", "or 'default'"),
        ([("delay",)], "two different disturbances, not delay"),
        ([("delay", "delay")], "two different disturbances, not delay"),
        ([("delay", "nois")], "noise"),
        ([("delay", "slow-down")], "sweep it alone"),
        ([("delay", "noise"), ("noise", "delay")], "twice"),
        ([{"delay": [0], "noise": [0.1]}], "besides 0"),
    ],
)
def test_other_pairs_are_refused(pairs, why):
    with pytest.raises(ConfigurationError, match=why):
        sweep(POLICIES, pairs=pairs, episodes=1)


def test_the_command_line_takes_names_and_levels():
    from armctl.cli.robustness import pairs_of

    assert pairs_of(["default"]) == "default"
    assert pairs_of(["delay,noise", "delay=2,4,payload=1.5"]) == [
        {"delay": None, "noise": None},
        {"delay": [2, 4], "payload": [1.5]},
    ]

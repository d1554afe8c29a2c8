"""How many episodes a comparison takes, from a pilot or in general."""

import math

import pytest

import armctl
from armctl.core.errors import ConfigurationError, ResultsError
from armctl.stats.power import detection_power, episodes_to_detect, episodes_to_show_equivalence, equivalence_power
from armctl.study.sample_size import plan_comparison
from armctl.verdict.tables import Remark


@pytest.mark.slow
def test_a_plan_from_a_pilot_has_a_row_for_each_pair(tmp_path):
    armctl.compare(["reach_ik", "random"], episodes=10, worlds=10, out=tmp_path)
    (pair,) = plan_comparison(0.05, pilot=tmp_path).tables[0].records
    assert pair["discordant"] == 11 / 12
    assert pair["episodes_to_detect"] > 2000
    general = plan_comparison(0.05, power=0.9)
    (table,) = general.tables
    needed = [record["episodes_to_detect"] for record in table.records if record["discordant"] >= 0.05]
    assert needed == sorted(needed)
    assert [row[1].text for row in table.rows] == ["-", "-", *(f"{number:,}" for number in needed)]
    assert (table.key, general.head) == ("plan", {"difference": 0.05, "power": 0.9})
    with_pilot, without = (
        [part.text for part in one.parts if isinstance(part, Remark)]
        for one in (plan_comparison(0.05, pilot=tmp_path), general)
    )
    until = "compare --until decided needs no number"
    assert with_pilot[0] == "Play them with another seed, or with the pilot's, which resumes it."
    assert [remarks[-1].startswith(until) for remarks in (with_pilot, without)] == [True, True]
    assert without[0].startswith("Two policies of 95 and 97 %")
    assert without[1] == "Policies that differ by 5 points differ in at least 5 % of their episodes."


@pytest.mark.slow
def test_a_share_of_episodes_below_the_difference_is_no_row_of_its_own_to_detect():
    for difference in (0.01, 0.02, 0.1, 0.3):
        for record in plan_comparison(difference).tables[0].records:
            assert (record["episodes_to_detect"] is None) == (record["discordant"] < difference)


@pytest.mark.slow
def test_a_plan_has_its_power_after_the_corrections_of_the_verdict(tmp_path):
    armctl.compare(["reach_ik", "reach_ppo", "reach_bc", "random"], episodes=10, worlds=10, out=tmp_path)
    document = plan_comparison(0.1, pilot=tmp_path)
    corrections = "to detect, for 18 tests of success, steps and return; to show equivalence, for 4 pairs"
    assert f"Bonferroni's correction ({corrections})" in document.tables[0].caption
    for record in document.tables[0].records:
        share = record["discordant"]
        assert record["episodes_to_detect"] == episodes_to_detect(0.1, share, tests=18)
        assert record["episodes_to_show_equivalence"] == episodes_to_show_equivalence(0.1, share, num_comparisons=4)


@pytest.mark.slow
def test_a_plan_without_a_pilot_is_for_a_single_pair_or_those_that_are_named():
    assert "to detect, for 3 tests of success, steps and return; to show equivalence, for 1 pair)" in (
        plan_comparison(0.1).tables[0].caption
    )
    one, six = (plan_comparison(0.1, pairs=pairs).tables[0].records for pairs in (None, 6))
    for name in ("episodes_to_detect", "episodes_to_show_equivalence"):
        counts = [(few[name], more[name]) for few, more in zip(one, six, strict=True) if few[name]]
        assert all(more > few for few, more in counts)
    with pytest.raises(ConfigurationError, match="from one to 1,000,000 pairs"):
        plan_comparison(0.1, pairs=0)


@pytest.mark.parametrize(
    ("difference", "power"),
    [
        (0.0, 0.8),
        (1.5, 0.8),
        (0.02, 0.0),
        (0.02, 1.0),
        (math.nan, 0.8),
        (1e-4, 0.8),
        (0.02, math.nan),
        (0.02, 1 - 1e-9),
    ],
)
def test_a_plan_needs_a_difference_and_a_power(difference, power):
    with pytest.raises(ConfigurationError, match=r"is from 0.1 to 100 %|up to 0.9999"):
        plan_comparison(difference, power)


@pytest.mark.parametrize("pairs", [-1, 10**6 + 1, 10**30, 10**400])
def test_a_plan_for_more_pairs_than_there_can_be(pairs):
    with pytest.raises(ConfigurationError, match="from one to 1,000,000 pairs"):
        plan_comparison(0.1, pairs=pairs)


def test_a_plan_for_very_many_pairs():
    records = plan_comparison(0.1, pairs=10**6).tables[0].records
    episodes = [record["episodes_to_detect"] for record in records if record["episodes_to_detect"]]
    assert episodes == sorted(episodes)
    assert 300 < episodes[0] < episodes[-1] < 2000


def test_a_plan_needs_results(tmp_path):
    with pytest.raises(ResultsError):
        plan_comparison(0.02, pilot=tmp_path)


@pytest.mark.slow
def test_a_plan_without_pairs_is_for_each_policy_by_itself():
    document = plan_comparison(0.1, unpaired=True)
    (table,) = document.tables
    assert [record["success"] for record in table.records] == [0.5, 0.7, 0.8, 0.9, 0.95, 0.98]
    assert [record["episodes_to_detect"] is None for record in table.records] == [False] * 5 + [True]
    for record in table.records[3:5]:
        needed = record["episodes_to_detect"]
        assert detection_power(needed, 0.1, record["success"], tests=3, paired=False) >= 0.8
        assert detection_power(needed - 1, 0.1, record["success"], tests=3, paired=False) < 0.8
        shown = record["episodes_to_show_equivalence"]
        assert equivalence_power(shown, 0.1, record["success"], paired=False) >= 0.8
        assert equivalence_power(shown - 1, 0.1, record["success"], paired=False) < 0.8
    assert "on different episodes" in table.caption
    remarks = [part.text for part in document.parts if isinstance(part, Remark)]
    assert remarks[-1] == "Policies that differ by 10 points have a mean success of 5 to 95 %."


@pytest.mark.slow
def test_a_pilot_may_be_planned_for_without_pairs(tmp_path):
    armctl.compare(["reach_ik", "random"], episodes=10, worlds=10, out=tmp_path)
    (pair,) = plan_comparison(0.05, pilot=tmp_path, unpaired=True).tables[0].records
    assert pair["success"] == 11 / 22
    assert pair["episodes_to_detect"] == episodes_to_detect(0.05, 0.5, tests=3, paired=False)

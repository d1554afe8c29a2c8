import dataclasses
import runpy
from pathlib import Path

import pytest

from armctl.robot_description import load_arm

measure = runpy.run_path(str(Path(__file__).parents[2] / "benchmarks/capsules.py"))["measure"]


@pytest.mark.one_case
@pytest.mark.parametrize("robot", ["ur5", "ur3", "ur10"])
def test_capsules_miss_no_contact_of_the_meshes(robot):
    alone, among = measure(robot, 2000)
    for counts in (alone, among):
        assert counts.touching[:, 1].mean() > 0.3
        assert counts.missed == 0
    assert alone.over_careful < 0.15
    assert among.over_careful < 0.2


def test_thinner_capsules_would_be_noticed():
    arm = load_arm("ur5")
    thinner = tuple(dataclasses.replace(one, radius=0.8 * one.radius) for one in arm.capsules)
    alone, among = measure(dataclasses.replace(arm, capsules=thinner), 1000)
    assert alone.missed > 0
    assert among.missed > alone.missed

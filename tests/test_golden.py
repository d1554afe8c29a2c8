"""The golden run, as far as another processor plays it alike: outcomes and lengths of classical policies' episodes.

`benchmarks/golden.json` is what `python benchmarks/golden.py record` has written. Who changes episodes on purpose
records it anew, and says so.
"""

import json
import runpy
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
golden = runpy.run_path(str(BENCHMARKS / "golden.py"))
RECORDED = json.loads((BENCHMARKS / "golden.json").read_text())
CASES = {golden["name_of"](*case): case for case in golden["cases"]()}
QUICK = [
    f"{golden['REACH']} {{}} reach_ik",
    f"{golden['OBSTACLES']} {{}} reach_ompl",
    f"{golden['BRIDGE']} {{}} bridge_ompl",
    f'{golden["REACH"]} {{"disturbances": {{"mismatch": 0.05}}}} reach_ik',
]


def test_every_case_is_recorded():
    assert list(RECORDED) == list(CASES)


@pytest.mark.parametrize("name", QUICK)
def test_episodes_are_as_recorded(name):
    check(name)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [name for name, case in CASES.items() if name not in QUICK and case[2] in (*golden["EXPERTS"], "random")],
)
def test_more_episodes_are_as_recorded(name):
    check(name)


def check(name):
    found = golden["tried"](*CASES[name])
    told = ["error", "outcomes"]
    if not name.startswith(golden["SCENES"]):  # another processor rounds otherwise, and random trees take another way
        told.append("lengths")
    assert {key: found.get(key) for key in told} == {key: RECORDED[name].get(key) for key in told}

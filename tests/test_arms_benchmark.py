"""`benchmarks/arms.py`, on one arm."""

import runpy
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def arms(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setenv("COLUMNS", "300")
    yield runpy.run_path(str(FOLDER / "arms.py"))
    sys.modules.pop("printing", None)


def test_an_arm_is_played(arms, capsys, tmp_path):
    arms["main"](episodes=3, policy=["reach_ik"], arm=["two joints"], cache=tmp_path)
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in capsys.readouterr().out.splitlines()]
    assert ["two joints", "URDF, example-robot-data", "2", "", "3"] in rows
    assert ["all", "", "", "", "100.0%"] in rows


def test_a_refused_arm_has_a_reason(arms, capsys, monkeypatch, tmp_path):
    (tmp_path / "lost").mkdir()
    arm = arms["Arm"]("lost", "lost.urdf", None, "lost")
    (tmp_path / "lost" / "lost.urdf").write_text('<robot name="lost"><link name="base"/></robot>')
    main = arms["main"]
    monkeypatch.setitem(main.__globals__, "arms", lambda: [arm])
    monkeypatch.setitem(main.__globals__, "fetch", lambda cache: None)
    main(episodes=1, policy=["reach_ik"], cache=tmp_path)
    assert "no revolute joint" in capsys.readouterr().out


def test_every_file_is_pinned(arms):
    pinned = (FOLDER / "arms_wheels.txt").read_text().splitlines()
    names = {line.split("==")[0].replace("-", "_") for line in pinned}
    assert all("--hash=sha256:" in line for line in pinned)
    assert {arm.wheel for arm in arms["arms"]() if arm.wheel} == names

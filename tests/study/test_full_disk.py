"""On a full disk: one clear line, a status that says so, and nothing half-written under a final name."""

import json
import shutil

import pytest

from armctl.policies.trainings import card_path
from armctl.study.results import read_study

from ..command_line import armctl, program

OPTIONS = ["--set", "max_episode_steps=12"]
SWEEP = ["sweep", "random", "reach_ik", "--disturbance", "delay=1,2", "--episodes", "12", "--out", "out", *OPTIONS]


def lines_of(done):
    assert "Traceback" not in done.stdout + done.stderr
    return [line for line in (done.stdout + done.stderr).splitlines() if "written" in line]


@pytest.fixture(scope="module", autouse=True)
def kernels(tmp_path_factory):
    """All that is compiled for these episodes, while there is room for it."""
    armctl(*SWEEP, cwd=tmp_path_factory.mktemp("kernels"))


@pytest.mark.slow
@pytest.mark.parametrize("disk", [600, 40_000, 100_000])
def test_a_sweep_on_a_full_disk_goes_on_later(tmp_path, disk):
    full = (program if disk == 40_000 else armctl)(*SWEEP, cwd=tmp_path, check=False, disk=disk)
    assert full.returncode in (1, 2)
    assert lines_of(full), full.stdout + full.stderr
    assert "sweep.csv has the curves" not in full.stdout
    armctl(*SWEEP, cwd=tmp_path)
    cells = read_study(tmp_path / "out").cells
    assert {name: len(cell.episodes) for name, cell in cells.items()} == {"none": 24, "delay-1.0": 24, "delay-2.0": 24}


@pytest.mark.slow
def test_a_report_on_a_full_disk_leaves_the_old_one(tmp_path):
    armctl("compare", "random", "--episodes", "2", "--out", "out", *OPTIONS, cwd=tmp_path)
    report = tmp_path / "out" / "report.html"
    for _ in range(2):
        full = armctl("report", "out", "--no-video", cwd=tmp_path, check=False, disk=100_000)
        assert full.returncode == 2
        assert full.stderr.count("\n") == len(lines_of(full)) == 1
        assert not list((tmp_path / "out").glob("*unfinished*"))
        if not report.exists():
            report.write_text("the old one")
    assert report.read_text() == "the old one"


@pytest.mark.slow
def test_agents_are_reproduced_without_a_disk(tmp_path):
    shipped = card_path("reach_ppo")
    card = json.loads(shipped.read_text())
    (tmp_path / "agent.json").write_text(json.dumps(card | {"evaluation": card["evaluation"] | {"episodes": 10}}))
    shutil.copy(shipped.with_suffix(".onnx"), tmp_path / "agent.onnx")
    done = program("reproduce", "agent.json", "--seed", "1", cwd=tmp_path, check=False, disk=0)
    assert done.returncode in (0, 1)
    assert "Traceback" not in done.stderr
    assert card["name"] in done.stdout

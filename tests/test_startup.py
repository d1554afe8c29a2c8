"""What a command imports before it says its first word: no heavy package that it does not need."""

import os
import subprocess
import sys

import pytest

from armctl.study import compare

HEAVY = {
    "casadi", "coal", "eaik", "h5py", "joblib", "jinja2", "matplotlib", "mujoco", "numba", "ompl", "onnx",
    "onnxruntime", "osqp", "pandas", "pinocchio", "plotly", "ruckig", "scipy.ndimage", "scipy.sparse", "scipy.spatial",
    "scipy.stats", "torch",
}  # fmt: skip
"""Packages that take a tenth of a second or more, or load one that does."""
CODE = """
import sys
from armctl.cli import main
try:
    main()
except SystemExit as exit:
    print(exit.code, *{heavy!r} & sys.modules.keys(), file=sys.stderr)
"""


def loaded(arguments, folder):
    """Return the exit status of a command, and the heavy packages that it has loaded."""
    done = subprocess.run(
        [sys.executable, "-c", CODE.replace("{heavy!r}", repr(HEAVY)), *arguments],
        capture_output=True,
        text=True,
        cwd=folder,
        env=os.environ | {"PYTHONSAFEPATH": "1"},
    )
    status, *packages = done.stderr.splitlines()[-1].split()
    return int(status), set(packages)


@pytest.mark.one_case
@pytest.mark.parametrize(
    "arguments", [["list"], ["plan", "--detect", "30"], ["plan", "--detect", "30", "--format", "json"], ["--version"]]
)
def test_a_verb_that_needs_no_simulator_loads_none(arguments, tmp_path):
    status, packages = loaded(arguments, tmp_path)
    assert status == 0
    assert packages <= {"scipy.sparse"}  # of which scipy.special takes a part


@pytest.mark.one_case
@pytest.mark.parametrize(
    "arguments",
    [
        ["compare", "reach_ikk"],
        ["compare", "--env", "armctl/Nope-v0"],
        ["compare", "--margin", "-3"],
        ["compare", "--set", "tolerence=1"],
        ["compare", "--env", "armctl/ArmReachMoving-v0", "--set", "hold_tim=1"],
        ["sweep", "--env", "armctl/BridgeCross-v0", "--set", "deck_lenght=10"],
        ["run", "random", "--set", "tolerence=1"],
        ["view", "random", "--set", "tolerence=1"],
        ["collect", "random", "--out", "data", "--set", "tolerence=1"],
        ["compare", "--set", "tolerance"],
        ["compare", "--baseline", "reach_ikk"],
        ["compare", "--no-such-flag"],
        ["sweep", "reach_ikk"],
        ["suite", "--env", "armctl/Nope-v0"],
        ["plan", "--detect", "0"],
        ["plan", "--pilot", "nowhere"],
        ["report", "nowhere"],
        ["episodes", "nowhere", "--csv"],
        ["reproduce", "reach_pp"],
        ["train", "reach_pp"],
        ["train", "ppo", "--env", "armctl/Nope-v0"],
        ["export", "model.zip", "--env", "armctl/Nope-v0"],
        ["run", "reach_ikk"],
        ["view", "reach_ikk"],
        ["collect", "reach_ikk", "--out", "data"],
        ["push", "reach_pp", "me/mine"],
        ["tune", "reach_saac"],
        ["list", "--env", "armctl/Nope-v0"],
    ],
    ids=" ".join,
)
def test_a_mistake_is_told_before_anything_heavy_is_loaded(arguments, tmp_path):
    status, packages = loaded(arguments, tmp_path)
    assert status == 2
    assert not packages


CONTROLLER = """
import sys, time
began = time.process_time()
import armctl.control.reach
unneeded = {"gymnasium", "mujoco", "pydantic", "jinja2", "osqp", "scipy.ndimage"}
print(time.process_time() - began, len(sys.modules), *unneeded & sys.modules.keys())
armctl.control.reach.ReachController()
print(*unneeded & sys.modules.keys())
import gymnasium
print("armctl/ArmReach-v0" in gymnasium.registry)
"""


def test_a_controller_of_a_real_arm_loads_no_simulator_and_gymnasium_knows_the_environments_later():
    """0.45 s of an idle core: numba takes 0.2 s of it, Pinocchio and NumPy 0.1 s each."""
    done = subprocess.run([sys.executable, "-c", CONTROLLER], capture_output=True, text=True)
    seconds, modules, *packages = done.stdout.split("\n")[0].split()
    assert not packages
    assert int(modules) < 750
    assert float(seconds) < 2.0, "on a busy core"
    assert done.stdout.split("\n")[1:3] == ["", "True"]


FIRST_EPISODE = """
import sys, armctl
armctl.compare(episodes=1, progress=lambda result: sys.exit(" ".join({heavy!r} & sys.modules.keys())))
"""


@pytest.mark.slow
def test_the_first_episode_waits_for_no_statistics(tmp_path):
    code = FIRST_EPISODE.replace("{heavy!r}", repr(HEAVY))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    packages = set(done.stderr.splitlines()[-1].split())
    assert "mujoco" in packages
    assert packages <= {"coal", "eaik", "mujoco", "numba", "onnx", "onnxruntime", "pinocchio"}


@pytest.mark.slow
def test_ten_thousand_episodes_are_judged_in_about_a_second_of_processor(tmp_path):
    """`judge` loads neither simulator nor pandas nor `scipy.stats`: 0.9 s on an idle core, half of it for imports."""
    rows = [f"{policy},{k},{int(k % 10 < wins)},{k % 7}" for k in range(5_000) for policy, wins in (("a", 8), ("b", 7))]
    (tmp_path / "trials.csv").write_text("\n".join(["policy,episode,success,return", *rows]))
    began = os.times()
    status, packages = loaded(["judge", "trials.csv"], tmp_path)
    ended = os.times()
    assert (status, packages - {"scipy.sparse"}) == (0, set())
    assert ended.children_user + ended.children_system - began.children_user - began.children_system < 2.5


@pytest.mark.slow
def test_a_report_loads_neither_simulator_nor_statistics(tmp_path):
    compare(["reach_ik", "random"], episodes=2, out=tmp_path / "results")
    status, packages = loaded(["report", "results", "--no-video"], tmp_path)
    assert (status, packages - {"scipy.sparse"}) == (0, {"jinja2", "pandas", "plotly"})

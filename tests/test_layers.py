"""The layout rules of pyproject.toml, `[tool.importlinter]`, checked on the package as it is installed.

And the length of functions, for which ruff has no rule.
"""

import ast
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HOME = Path(__file__).parents[1]


@pytest.fixture
def package(tmp_path):
    """All of armctl in one folder, with its plug-ins where an installation has them."""
    shutil.copytree(HOME / "src" / "armctl", tmp_path / "armctl")
    for plug_in in ("baselines", "rl"):
        shutil.copytree(HOME / plug_in, tmp_path / "armctl" / plug_in)
    shutil.copy(HOME / "pyproject.toml", tmp_path)
    return tmp_path


def lint(folder):
    command = [str(Path(sys.executable).with_name("lint-imports")), "--config", "pyproject.toml", "--no-cache"]
    done = subprocess.run(
        command, cwd=folder, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(folder)}
    )
    return done.returncode, done.stdout + done.stderr


def test_imports_run_down_only_and_without_circles(package):
    status, says = lint(package)
    assert status == 0, says
    assert "5 kept, 0 broken" in says


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("module", "imports"),
    [
        ("kinematics/model.py", "armctl.simulation"),
        ("episodes/metrics.py", "armctl.report"),
        ("tasks/task.py", "armctl.rl.networks.view"),
        ("control/pursuit.py", "mujoco"),
        ("datasets/formats.py", "armctl.integrations.lerobot.dataset"),
        ("integrations/sb3.py", "armctl.integrations.rerun"),
        ("planning/cost_to_go.py", "armctl.planning.bridge_planner"),
    ],
)
def test_an_import_that_runs_up_is_found(package, module, imports):
    file = package / "armctl" / module
    circle = "\nimport armctl.planning.cost_to_go\n"
    file.write_text(f"import {imports}\n" + file.read_text())
    if "cost_to_go" in module:
        other = package / "armctl/planning/bridge_planner.py"
        other.write_text(other.read_text() + circle)
    status, says = lint(package)
    assert status == 1, says
    assert "broken" in says


def test_no_file_is_long():
    lengths = {
        str(path.relative_to(HOME)): len(path.read_text().splitlines())
        for folder in ("src", "baselines", "rl", "tools", "tests", "benchmarks")
        for path in (HOME / folder).rglob("*.py")
    }
    assert {path: length for path, length in lengths.items() if length > 350} == {}


MAX_LINES = 60


def long_functions(file):
    functions = (node for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.FunctionDef))
    return [node.name for node in functions if node.end_lineno - node.lineno >= MAX_LINES]


def test_no_function_is_longer_than_60_lines():
    files = [file for folder in ("src", "rl", "baselines", "tools") for file in (HOME / folder).rglob("*.py")]
    longer = {str(file.relative_to(HOME)): names for file in files if (names := long_functions(file))}
    assert not longer

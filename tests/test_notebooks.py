import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
FEWER = {
    "1_first_steps": {r"every=[48]\)": "every=40)", "=50": "=10"},
    "2_kinematics": {"np.pi, 121": "np.pi, 21", r"\[:200,": "[:20,"},
    "3_baseline_against_ppo": {"=20": "=5", "=100": "=20"},
    "4_reward_shaping": {r"range\(100\)": "range(10)", "1, 81": "1, 21"},
    "5_your_own": {r"\b(100|50)\b": "10"},
    "6_training_an_agent": {
        "100,  #": "10,  #", "2_000": "200", "250": "100", '_episodes": [12]00': '_episodes": 10', "=[12]00": "=10",
    },
    "7_disturbances": {"=10": "=2", "=30": "=10", "=120|=60": "=20"},
    "8_any_environment": {"25_000": "2_048", "=50": "=10"},
}  # fmt: skip
"""Patterns of numbers in cells, and fewer episodes, steps, points and pictures, with which the same cells run."""


def test_there_are_notebooks():
    assert [path.name[0] for path in NOTEBOOKS] == ["1", "2", "3", "4", "5", "6", "7", "8"]


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, tmp_path):
    kept, begun = json.loads(path.read_text()), with_fewer(path)
    (tmp_path / path.name).write_text(json.dumps(begun))
    command = [sys.executable, ROOT / "notebooks/execute.py", tmp_path / path.name]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    executed = json.loads((tmp_path / path.name).read_text())
    assert ["".join(cell["source"]) for cell in executed["cells"]] == [cell["source"] for cell in begun["cells"]]
    assert [_kinds(cell) for cell in executed["cells"]] == [_kinds(cell) for cell in kept["cells"]]
    _check_outputs(executed)


def with_fewer(path):
    """Return the notebook with the numbers of `FEWER` in its code."""
    notebook = json.loads(path.read_text())
    for cell in notebook["cells"]:
        cell["source"] = "".join(cell["source"])
    for pattern, number in FEWER[path.stem].items():
        assert any(re.search(pattern, cell["source"]) for cell in _cells(notebook, "code")), pattern
        for cell in _cells(notebook, "code"):
            cell["source"] = re.sub(pattern, number, cell["source"])
    return notebook


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_kept_outputs_are_whole(path):
    _check_outputs(json.loads(path.read_text()))
    assert path.stat().st_size < 1_500_000


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_links_lead_somewhere(path):
    prose = "".join("".join(cell["source"]) for cell in _cells(json.loads(path.read_text()), "markdown"))
    for link in re.findall(r"\]\(([^)]+)\)", prose):
        assert link.startswith("https://") or (path.parent / link.partition("#")[0]).exists(), link


def _check_outputs(notebook):
    cells = _cells(notebook, "code")
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    for cell in cells:
        for output in cell["outputs"]:
            assert output["output_type"] != "error"
            assert output.get("name") != "stderr", output["text"]
            text = json.dumps(
                [output.get("text", ""), {k: v for k, v in output.get("data", {}).items() if "image" not in k}]
            )
            strange = re.search(r"/(home|root|tmp|usr|work|Users)/|site-packages|https?://| at 0x|\w+Warning", text)
            assert strange is None, strange


def _cells(notebook, kind):
    return [cell for cell in notebook["cells"] if cell["cell_type"] == kind]


def _kinds(cell):
    """What kinds of output a cell has."""
    return [sorted(output.get("data", {"text": ""})) for output in cell.get("outputs", [])]

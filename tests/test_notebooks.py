import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


def test_there_are_notebooks():
    assert [path.name[0] for path in NOTEBOOKS] == ["1", "2", "3", "4", "5", "6", "7", "8"]


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, tmp_path):
    command = [sys.executable, ROOT / "notebooks/execute.py", path, "--out", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    executed, kept = (json.loads((folder / path.name).read_text()) for folder in (tmp_path, path.parent))
    assert [cell["source"] for cell in executed["cells"]] == [cell["source"] for cell in kept["cells"]]
    assert [_kinds(cell) for cell in executed["cells"]] == [_kinds(cell) for cell in kept["cells"]]
    _check_outputs(executed)


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

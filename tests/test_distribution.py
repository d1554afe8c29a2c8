"""The distribution has a name of its own; `armctl` on the package index is somebody else's."""

import os
import re
import subprocess
import sys
from importlib.metadata import metadata
from pathlib import Path

import armctl

ROOT = Path(__file__).parents[1]


def test_the_distribution_is_ours():
    assert metadata(armctl.DISTRIBUTION)["Summary"].startswith("Planners and controllers against learned agents")


def test_no_hint_fetches_the_stranger():
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in tracked.splitlines():
        if Path(name).suffix in (".md", ".py", ".toml", ".yml", ".ipynb", "") and (ROOT / name).is_file():
            text = (ROOT / name).read_text(errors="ignore")
            assert not re.search(r"\b(install|uv add) [^\n]*['\" ]armctl(\[|['\"`\s]*$|==)", text, re.MULTILINE), name


def test_another_armctl_beside_it_is_warned_of(tmp_path):
    stranger = tmp_path / "armctl-0.5.0.dist-info"
    stranger.mkdir()
    (stranger / "METADATA").write_text("Metadata-Version: 2.1\nName: armctl\nVersion: 0.5.0\n")
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", "import armctl"], capture_output=True, text=True, env=environment)
    assert done.returncode == 0
    assert "another project with the same import name" in done.stderr
    alone = subprocess.run([sys.executable, "-W", "error", "-c", "import armctl"], capture_output=True, text=True)
    assert alone.returncode == 0, alone.stderr

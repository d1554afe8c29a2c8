"""Dataset formats come from installed packages, those of others too."""

import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from armctl.core.files import bounded_text, unsealed
from armctl.datasets.formats import FORMATS, load_formats

from .collections_of_random import ARMCTL

EXTEND = Path(__file__).parents[2] / "docs" / "extend.md"


def test_armctl_offers_two_formats():
    assert list(load_formats()) == ["lerobot", "minari"]
    assert all(kind.MANIFEST.startswith(kind.PARTS[-1]) for kind in load_formats().values())


@pytest.mark.slow
def test_the_format_of_another_package_is_written_and_resumed(tmp_path):
    """The module of the documentation, in a package that is installed in a folder."""
    about = tmp_path / "site" / "mine-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[{FORMATS}]\nnpz = npz_format\n")
    (module,) = re.findall(r"^```python npz_format.py\n(.*?)^```$", EXTEND.read_text(), re.MULTILINE | re.DOTALL)
    (tmp_path / "site" / "npz_format.py").write_text(module)
    command = [ARMCTL, "collect", "random", "--episodes", "2", "--set", "max_episode_steps=5"]
    command += ["--format", "npz", "--out", tmp_path / "data"]
    for expected in ("2 episodes of random, 10 control steps", "Resumed: 2 of 2 episodes"):
        done = subprocess.run(
            command, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(tmp_path / "site")}
        )
        assert expected in done.stdout, done.stdout + done.stderr
    assert np.load(tmp_path / "data/npz/1.npz")["actions"].shape == (5, 6)
    assert unsealed(bounded_text(tmp_path / "data/npz/about.json"))["versions"]["numpy"] == np.__version__

"""The cache of compiled kernels: damage to it, a full disk and others' folders stop nothing."""

import os
import shutil
import subprocess
import sys

import pytest

from ..command_line import full_disk

PROGRAM = """
import numpy as np
from armctl.kernels.compiling import compiled

def double(values, out):
    for i in range(len(values)):
        out[i] = 2 * values[i]

kernel = compiled(double)
out = np.zeros(3)
kernel(np.ones(3), out)
print(out.sum(), sum(kernel.stats.cache_hits.values()))
"""


def run(folder, home):
    (folder / "own_kernel.py").write_text(PROGRAM)
    done = subprocess.run(
        [sys.executable, "own_kernel.py"],
        cwd=folder,
        env=os.environ | {"XDG_CACHE_HOME": str(home), "NUMBA_CACHE_DIR": ""},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    total, hits = done.stdout.split()
    assert float(total) == 6
    return int(hits)


def cached(home):
    return [path for path in home.rglob("*") if path.suffix in (".nbi", ".nbc")]


@pytest.mark.slow
def test_damage_is_compiled_again(tmp_path):
    home = tmp_path / "cache"
    assert run(tmp_path, home) == 0
    assert run(tmp_path, home) == 1
    for suffix, damage in [(".nbi", b""), (".nbi", b"what"), (".nbc", b"\x80")]:
        for path in cached(home):
            if path.suffix == suffix:
                path.write_bytes(damage)
        assert run(tmp_path, home) == 0, (suffix, damage)
        assert run(tmp_path, home) == 1, (suffix, damage)


@pytest.mark.slow
def test_a_full_disk_stops_nothing(tmp_path):
    home = tmp_path / "cache"
    (tmp_path / "own_kernel.py").write_text(PROGRAM)
    with full_disk(500):
        assert run(tmp_path, home) == 0


@pytest.mark.slow
def test_the_folder_is_private(tmp_path):
    home = tmp_path / "cache"
    run(tmp_path, home)
    (folder,) = (home / "armctl").iterdir()
    assert folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o777)
    run(tmp_path, home)
    assert folder.stat().st_mode & 0o777 == 0o700
    shutil.rmtree(folder)
    folder.write_text("in its place")
    assert run(tmp_path, home) == 0

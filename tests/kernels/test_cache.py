"""The cache of compiled kernels: damage to it, a full disk and others' folders stop nothing; an interrupt does."""

import runpy
import shutil
import signal

import numba
import pytest
from numba.core.registry import cpu_target

from armctl.kernels import compiling

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
"""


@pytest.fixture
def home(tmp_path, monkeypatch):
    """A cache folder of the test's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    (tmp_path / "own_kernel.py").write_text(PROGRAM)
    return tmp_path / "cache"


def run(home, monkeypatch):
    """Compile and call a kernel as a new process would; return how many were read from the cache."""
    monkeypatch.setattr(compiling, "_FOLDER", compiling._cache_folder())
    names = runpy.run_path(str(home.parent / "own_kernel.py"))
    assert names["out"].sum() == 6
    return sum(names["kernel"].stats.cache_hits.values())


def cached(home):
    return [path for path in home.rglob("*") if path.suffix in (".nbi", ".nbc")]


def test_damage_is_compiled_again(home, monkeypatch):
    assert run(home, monkeypatch) == 0
    assert run(home, monkeypatch) == 1
    for suffix, damage in [(".nbi", b""), (".nbi", b"what"), (".nbc", b"\x80")]:
        for path in cached(home):
            if path.suffix == suffix:
                path.write_bytes(damage)
        assert run(home, monkeypatch) == 0, (suffix, damage)
        assert run(home, monkeypatch) == 1, (suffix, damage)


def test_a_full_disk_stops_nothing(home, monkeypatch):
    with full_disk(500):
        assert run(home, monkeypatch) == 0


def test_installations_share_the_machine_code_of_kernels_and_no_other(home):
    kernels = compiling.KERNELS / "geometry.py"
    assert compiling._Locator.get_suitable_cache_subpath(str(kernels)) == "kernels"
    others = {compiling._Locator.get_suitable_cache_subpath(str(home / name / "own.py")) for name in ("a", "b")}
    assert len(others | {"kernels"}) == 3


def test_the_folder_is_private(home, monkeypatch):
    run(home, monkeypatch)
    (folder,) = (home / "armctl").iterdir()
    assert folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o777)
    run(home, monkeypatch)
    assert folder.stat().st_mode & 0o777 == 0o700
    shutil.rmtree(folder)
    folder.write_text("in its place")
    assert run(home, monkeypatch) == 0


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_interrupt_while_machine_code_is_made_is_heard(home, monkeypatch):
    engine = cpu_target.target_context.codegen()._engine._ee
    with monkeypatch.context() as at_its_end:
        at_its_end.setattr(engine, "_object_cache_notify", lambda *_: signal.raise_signal(signal.SIGINT))
        with pytest.raises(KeyboardInterrupt):
            run(home, monkeypatch)
    assert run(home, monkeypatch) == 0

"""`pytest` runs the quick tests, `pytest --all` also the slow ones, and quick ones with their full samples."""

import compileall
import gc
import os
import shutil
import signal
import sys
import tomllib
from functools import cache, partial
from importlib.metadata import distribution
from pathlib import Path
from types import SimpleNamespace

import hypothesis
import pytest

import armctl  # noqa: F401 - before any test imports MuJoCo, which chooses its OpenGL then
from armctl.envs import policy_seed

from .command_line import POLICY_SEED
from .time_limit import pytest_fixture_setup, pytest_runtest_call, pytest_runtest_protocol  # noqa: F401 - hooks

# A shell that runs the tests in the background ignores interrupts, and whatever the tests interrupt would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

vars(policy_seed)["secrets"] = SimpleNamespace(randbits=lambda bits: POLICY_SEED)
"""In this process, policies that draw random numbers repeat themselves exactly in another run."""

hypothesis.settings.register_profile("armctl", deadline=None)  # which a busy machine or coverage would miss
hypothesis.settings.load_profile("armctl")

MARKERS = {"slow": "--all", "thorough": "--thorough"}
"""What runs with which option."""

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")


def pytest_addoption(parser):
    parser.addoption("--all", action="store_true", help="run slow tests too, and take full samples")
    parser.addoption("--thorough", action="store_true", help="run tests of thousands of trials too")


def pytest_sessionstart(session):
    """Stop if the installed armctl lacks entry points of pyproject.toml: plug-ins would not be found.

    Its code is compiled once, and not by each interpreter that a test starts, if none may keep what it compiles.
    """
    if not hasattr(session.config, "workerinput"):
        for folder in ("src", "baselines", "rl"):
            compileall.compile_dir(Path(__file__).parents[1] / folder, quiet=2)
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
    declared = {
        (group, name): value for group, points in project["entry-points"].items() for name, value in points.items()
    }
    installed = {(point.group, point.name): point.value for point in distribution(project["name"]).entry_points}
    if declared.items() - installed.items():
        pytest.exit("pyproject.toml has new entry points: pip install --no-deps --no-build-isolation -e .", 4)


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Collect no garbage meanwhile, and never look at modules and tests again: a quarter of a collection's time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.collect()
        gc.freeze()
        gc.set_threshold(20_000)  # 700 by default: a collection each few milliseconds, 2 % of the tests' time


@cache
def draws_with_opengl():
    import mujoco

    try:
        mujoco.GLContext(16, 16).free()
    except Exception:  # each of its three backends raises another one
        return False
    return True


MISSING = {
    "browser": (lambda: CHROMIUM is None, "no Chromium here: apt-get install chromium"),
    "opengl": (lambda: not draws_with_opengl(), "no OpenGL here: apt-get install libegl1 libgl1-mesa-dri"),
}
"""What a marker needs: how to find out that the machine lacks it, and what to say then."""


def pytest_collection_modifyitems(config, items):
    """Leave out what was not asked for, and what this machine cannot run: with `--all`, that is told of as skipped."""
    kept, left_out, with_a_case = [], [], set()
    for item in items:
        markers = {marker.name for marker in item.iter_markers()}
        missing = [reason for marker, (is_missing, reason) in MISSING.items() if marker in markers and is_missing()]
        is_asked_for = all(config.getoption(MARKERS[marker]) for marker in markers & MARKERS.keys())
        if is_asked_for and "one_case" in markers and not config.getoption("--all"):
            is_asked_for = item.function not in with_a_case
            with_a_case.add(item.function)
        if missing and config.getoption("--all"):
            item.add_marker(pytest.mark.skip(reason=missing[0]))
            missing = []
        (kept if is_asked_for and not missing else left_out).append(item)
    # Files beside the folders have the longest tests: begun last, one of them would keep a single worker busy.
    items[:] = sorted(kept, key=lambda item: len(item.path.parts))
    config.hook.pytest_deselected(items=left_out)


@pytest.fixture(autouse=True)
def idle_machine(monkeypatch):
    """Whether deadlines are judged does not depend on what else the machine does."""
    monkeypatch.setattr(os, "getloadavg", lambda: (0.0, 0.0, 0.0), raising=False)


@pytest.fixture(autouse=True)
def operators_of_onnx():
    """Torch looks up its operators for its exporter once, not for every graph: half of a small one's time."""
    if module := sys.modules.get("torch.onnx._internal.exporter._registration"):
        registry, operators = module.ONNXRegistry, sys.modules["torch._export.utils"]
        if not hasattr(registry.from_torchlib, "cache_info"):
            registry.from_torchlib = staticmethod(cache(registry.from_torchlib))
            vars(operators)["_materialize_cpp_cia_ops"] = cache(operators._materialize_cpp_cia_ops)


@pytest.fixture(scope="session")
def sized(request):
    """A sample's size: the first of two, and with `--all` the second."""
    return lambda quick, full: full if request.config.getoption("--all") else quick


@pytest.fixture
def chromium():
    """A browser without a window, which draws with the processor."""
    from playwright.sync_api import sync_playwright

    arguments = ["--no-sandbox", "--enable-unsafe-swiftshader", "--use-angle=swiftshader"]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments)
        browser.new_page = partial(patient_page, browser.new_page)
        yield browser
        browser.close()


def patient_page(new_page, **options):
    """A page that loads on a busy machine, too."""
    page = new_page(**options)
    page.set_default_timeout(200_000)
    return page

"""`pytest` runs the quick tests, `pytest --all` also the slow ones, and quick ones with their full samples."""

import os
import shutil
import signal
import sys
import tomllib
from functools import cache
from importlib.metadata import distribution
from pathlib import Path
from types import SimpleNamespace

import hypothesis
import pytest
from _pytest.runner import runtestprotocol

import armctl  # noqa: F401 - before any test imports MuJoCo, which chooses its OpenGL then
from armctl.envs import policy_seed

from .command_line import POLICY_SEED

# A shell that runs the tests in the background ignores interrupts, and whatever the tests interrupt would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

vars(policy_seed)["secrets"] = SimpleNamespace(randbits=lambda bits: POLICY_SEED)
"""In this process, policies that draw random numbers repeat themselves exactly in another run."""

hypothesis.settings.register_profile("armctl", deadline=None)  # which a busy machine or coverage would miss
hypothesis.settings.load_profile("armctl")

MARKERS = {"slow": "--all", "thorough": "--thorough"}
"""What runs with which option."""

QUICK_S = 2.0
"""Processor time that an unmarked test may use, in seconds: its call and its own fixtures, with child processes."""

QUICK_ON_A_BUSY_MACHINE_S = 3.0
"""The same where other processes run beside it, which share caches and floating-point units."""

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

processor_seconds = pytest.StashKey[float]()


def pytest_addoption(parser):
    parser.addoption("--all", action="store_true", help="run slow tests too, and take full samples")
    parser.addoption("--thorough", action="store_true", help="run tests of thousands of trials too")


def pytest_sessionstart():
    """Stop if the installed armctl lacks entry points of pyproject.toml: plug-ins would not be found."""
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
    declared = {
        (group, name): value for group, points in project["entry-points"].items() for name, value in points.items()
    }
    installed = {(point.group, point.name): point.value for point in distribution(project["name"]).entry_points}
    if declared.items() - installed.items():
        pytest.exit("pyproject.toml has new entry points: pip install --no-deps --no-build-isolation -e .", 4)


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
    kept, left_out = [], []
    for item in items:
        markers = {marker.name for marker in item.iter_markers()}
        missing = [reason for marker, (is_missing, reason) in MISSING.items() if marker in markers and is_missing()]
        is_asked_for = all(config.getoption(MARKERS[marker]) for marker in markers & MARKERS.keys())
        if missing and config.getoption("--all"):
            item.add_marker(pytest.mark.skip(reason=missing[0]))
            missing = []
        (kept if is_asked_for and not missing else left_out).append(item)
    items[:] = kept
    config.hook.pytest_deselected(items=left_out)


def processor_time():
    """Return what this process and the children that it has waited for have used, in seconds."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item):
    start = processor_time()
    try:
        return (yield)
    finally:
        item.stash[processor_seconds] += processor_time() - start


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup(fixturedef, request):
    start = processor_time()
    try:
        return (yield)
    finally:
        if fixturedef.scope == "function":
            request.node.stash[processor_seconds] += processor_time() - start


def pytest_runtest_protocol(item, nextitem):
    """Fail a test of the quick run that is not quick; the second time counts, as the first may import and compile."""

    def run():
        item.stash[processor_seconds] = 0.0
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        return reports, item.stash[processor_seconds], all(report.passed for report in reports)

    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    limit = QUICK_ON_A_BUSY_MACHINE_S if os.getloadavg()[0] > os.cpu_count() / 2 else QUICK_S
    reports, seconds, has_passed = run()
    # Full samples, coverage and debuggers take longer.
    is_timed = not (item.config.getoption("--all") or sys.gettrace())
    if is_timed and has_passed and seconds > limit:
        _, seconds, has_passed = run()
        if has_passed and seconds > limit:
            _, call, _ = reports
            call.outcome = "failed"
            call.longrepr = f"{seconds:.1f} s of processor time: a test without the mark `slow` takes at most {limit} s"
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


@pytest.fixture(autouse=True)
def idle_machine(monkeypatch):
    """Whether deadlines are judged does not depend on what else the machine does."""
    monkeypatch.setattr(os, "getloadavg", lambda: (0.0, 0.0, 0.0), raising=False)


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
        yield browser
        browser.close()

"""`pytest` runs the quick tests, `pytest --all` also the slow ones, and quick ones with their full samples."""

import os
import signal
import tomllib
from importlib.metadata import distribution
from pathlib import Path
from types import SimpleNamespace

import pytest

import armctl  # noqa: F401 - before any test imports MuJoCo, which chooses its OpenGL then
from armctl.envs import policy_seed

from .command_line import POLICY_SEED

# A shell that runs the tests in the background ignores interrupts, and whatever the tests interrupt would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

policy_seed.secrets = SimpleNamespace(randbits=lambda bits: POLICY_SEED)
"""In this process, policies that draw random numbers repeat themselves exactly in another run."""

MARKERS = {"slow": "--all", "thorough": "--thorough"}
"""What runs with which option."""


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


def pytest_collection_modifyitems(config, items):
    left_out = {marker for marker, option in MARKERS.items() if not config.getoption(option)}
    others = [item for item in items if left_out.intersection(marker.name for marker in item.iter_markers())]
    items[:] = [item for item in items if item not in others]
    config.hook.pytest_deselected(items=others)


@pytest.fixture(autouse=True)
def idle_machine(monkeypatch):
    """Whether deadlines are judged does not depend on what else the machine does."""
    monkeypatch.setattr(os, "getloadavg", lambda: (0.0, 0.0, 0.0), raising=False)


@pytest.fixture(scope="session")
def sized(request):
    """A sample's size: the first of two, and with `--all` the second."""
    return lambda quick, full: full if request.config.getoption("--all") else quick

"""`pytest` runs the quick tests, `pytest --all` also the slow ones, and quick ones with their full samples."""

import signal

import pytest

import armctl  # noqa: F401 - before any test imports MuJoCo, which chooses its OpenGL then

# A shell that runs the tests in the background ignores interrupts, and whatever the tests interrupt would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser):
    parser.addoption("--all", action="store_true", help="run slow tests too, and take full samples")


def pytest_collection_modifyitems(config, items):
    if config.getoption("--all"):
        return
    slow = [item for item in items if item.get_closest_marker("slow")]
    items[:] = [item for item in items if item not in slow]
    config.hook.pytest_deselected(items=slow)


@pytest.fixture(scope="session")
def sized(request):
    """A sample's size: the first of two, and with `--all` the second."""
    return lambda quick, full: full if request.config.getoption("--all") else quick

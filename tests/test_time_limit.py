"""The quick run fails what is not quick: `time_limit.py`, in a run of pytest within this one, with a small limit."""

import sys

import pytest

from . import time_limit

pytest_plugins = ["pytester"]

WORK = """
import subprocess, sys, time
import pytest

def work(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass
"""


@pytest.fixture
def outcome_of(pytester, monkeypatch):
    """The outcome of a test with this source, and what is said of a failure; the limit is 50 ms."""
    monkeypatch.setattr(time_limit, "QUICK_S", 0.05)
    monkeypatch.setattr(sys, "gettrace", lambda: None)  # under coverage nothing is timed
    monkeypatch.setenv("PYTEST_DISABLE_PLUGIN_AUTOLOAD", "1")  # installed plug-ins take long to load

    def run(source, *arguments):
        pytester.makepyfile(WORK + source)
        plugins = [time_limit, *arguments]
        report = pytester.inline_run("-p", "no:cacheprovider", plugins=plugins)
        (call,) = [one for one in report.getreports("pytest_runtest_logreport") if one.when == "call"]
        return call.outcome, str(call.longrepr or "")

    return run


SLOW = {
    "the test": "def test_it(): work(0.1)",
    "its fixture": "@pytest.fixture\ndef own(): work(0.1)\ndef test_it(own): pass",
    "a process": "def test_it(): subprocess.run([sys.executable, '-c', 'sum(range(10**7))'])",
}
QUICK = {
    "nothing": "def test_it(): pass",
    "waiting": "def test_it(): time.sleep(0.1)",
    "what many share": "@pytest.fixture(scope='module')\ndef shared(): work(0.1)\ndef test_it(shared): pass",
    "what happens once": "left = [0.1]\ndef test_it(): work(left.pop() if left else 0)",
}


@pytest.mark.one_case
@pytest.mark.parametrize("source", SLOW.values(), ids=SLOW)
def test_a_test_that_uses_more_than_the_limit_fails(outcome_of, source):
    outcome, reason = outcome_of(source)
    assert outcome == "failed"
    assert "s of processor time: a test without the mark `slow` takes at most 0.05 s" in reason


@pytest.mark.parametrize("source", QUICK.values(), ids=QUICK)
def test_a_quick_test_passes(outcome_of, source):
    assert outcome_of(source) == ("passed", "")


def test_a_test_that_fails_says_its_own_reason(outcome_of):
    outcome, reason = outcome_of("def test_it():\n    work(0.1)\n    assert False, 'its own reason'")
    assert outcome == "failed"
    assert "its own reason" in reason


def test_full_samples_may_take_longer(outcome_of):
    class Everything:
        def pytest_addoption(self, parser):
            parser.addoption("--all", action="store_true", default=True)

    assert outcome_of(SLOW["the test"], Everything())[0] == "passed"

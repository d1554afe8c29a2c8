"""A test of the quick run that is not quick fails: hooks of pytest."""

import os
import sys

import pytest
from _pytest.runner import runtestprotocol

QUICK_S = 2.0
"""Processor time that an unmarked test may use, in seconds: its call and its own fixtures, with child processes."""

QUICK_ON_A_BUSY_MACHINE_S = 3.0
"""The same where other processes run beside it, which share caches and floating-point units."""

processor_seconds = pytest.StashKey[float]()


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
    is_timed = not (item.config.getoption("--all", default=False) or sys.gettrace())
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

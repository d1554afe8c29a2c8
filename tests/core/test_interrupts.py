"""Interrupts that compiled code swallows are raised after it."""

import ctypes
import signal
import threading

import pytest

from armctl.core.interrupts import interrupts_raised


@pytest.fixture(autouse=True)
def no_complaints(monkeypatch):
    """What ctypes swallows is no warning of the test's."""
    swallowed = []
    monkeypatch.setattr("sys.unraisablehook", swallowed.append)
    return swallowed


@ctypes.CFUNCTYPE(None)
def interrupted():
    signal.raise_signal(signal.SIGINT)


def test_what_a_callback_swallows_is_raised_after_the_block(no_complaints):
    after = []
    with pytest.raises(KeyboardInterrupt), interrupts_raised():
        interrupted()
        after.append(1)
    assert len(no_complaints) == len(after) == 1


def test_a_failure_by_the_interrupt_is_the_interrupt():
    with pytest.raises(KeyboardInterrupt), interrupts_raised():
        interrupted()
        raise RuntimeError("no compiled object yet")


def test_other_failures_stay_what_they_are():
    with pytest.raises(RuntimeError, match="own"), interrupts_raised():
        raise RuntimeError("own")


def test_an_interrupt_that_nothing_swallows_is_raised_where_it_comes():
    after = []
    with pytest.raises(KeyboardInterrupt), interrupts_raised():
        signal.raise_signal(signal.SIGINT)
        after.append(1)
    assert not after


def test_blocks_within_blocks_end_one_after_the_other():
    after = []
    with pytest.raises(KeyboardInterrupt), interrupts_raised():
        with interrupts_raised():
            interrupted()
        after.append(1)
    assert not after


@pytest.mark.parametrize("handler", [signal.SIG_IGN, lambda number, frame: None])
def test_who_ignores_interrupts_gets_none(handler):
    previous = signal.signal(signal.SIGINT, handler)
    try:
        with interrupts_raised():
            signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) is handler
    finally:
        signal.signal(signal.SIGINT, previous)


def test_the_handler_is_as_before_and_other_threads_leave_it_alone():
    before, seen = signal.getsignal(signal.SIGINT), []

    @interrupts_raised()
    def look():
        seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    look()
    assert seen[0] is before is signal.getsignal(signal.SIGINT)
    assert seen[1] is not before

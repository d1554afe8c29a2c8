"""Interrupts that compiled code swallows are raised after it."""

import ctypes
import signal
import threading

import pytest

from armctl.core.interrupts import interrupts_raised

STEPS = []
"""Which lines have run."""


@pytest.fixture(autouse=True)
def ctypes_errors(monkeypatch):
    """What ctypes writes to stderr, and goes on."""
    errors = []
    STEPS.clear()
    monkeypatch.setattr("sys.unraisablehook", errors.append)
    return errors


@ctypes.CFUNCTYPE(None)
def interrupted():
    signal.raise_signal(signal.SIGINT)


@interrupts_raised()
def in_a_callback():
    interrupted()
    STEPS.append("after")


@interrupts_raised()
def in_a_callback_then_fail():
    interrupted()
    raise RuntimeError("no compiled object yet")


@interrupts_raised()
def in_python():
    signal.raise_signal(signal.SIGINT)
    STEPS.append("after")


@interrupts_raised()
def in_a_block_within():
    in_a_callback()
    STEPS.append("outer")


@pytest.mark.parametrize(
    ("interrupt", "steps", "swallows"),
    [
        (in_a_callback, ["after"], 1),
        (in_a_callback_then_fail, [], 1),
        (in_python, [], 0),
        (in_a_block_within, ["after"], 1),
    ],
)
def test_an_interrupt_is_raised_once(interrupt, steps, swallows, ctypes_errors):
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        interrupt()
    assert steps == STEPS
    assert len(ctypes_errors) == swallows
    assert signal.getsignal(signal.SIGINT) is before


def test_other_failures_stay_what_they_are():
    with pytest.raises(RuntimeError, match="own"), interrupts_raised():
        raise RuntimeError("own")


@pytest.mark.parametrize("handler", [signal.SIG_IGN, lambda number, frame: None])
def test_who_ignores_interrupts_gets_none(handler):
    previous = signal.signal(signal.SIGINT, handler)
    try:
        in_a_callback()
        assert signal.getsignal(signal.SIGINT) is handler
    finally:
        signal.signal(signal.SIGINT, previous)


def test_other_threads_leave_the_handler_alone():
    before, handlers = signal.getsignal(signal.SIGINT), []
    look = interrupts_raised()(lambda: handlers.append(signal.getsignal(signal.SIGINT)))
    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    look()
    assert handlers[0] is before
    assert handlers[1] is not before

import pytest

from armctl.rollout import decision_times


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    """The clock of decision times, which only the test advances."""
    made = Clock()
    monkeypatch.setattr(decision_times, "perf_counter", made)
    return made

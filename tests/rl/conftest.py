"""Fixtures of the tests of learners."""

import pytest

from armctl.rl.networks.actor import Actor
from armctl.rl.run.training import Training
from tests.sealing import sealed  # noqa: F401 - a fixture


@pytest.fixture
def unexported(monkeypatch):
    """Trainings write an empty file as the agent's graph, which takes a second to export, and do not evaluate it."""
    monkeypatch.setattr(Actor, "export", lambda actor, path: path.write_bytes(b""))
    monkeypatch.setattr(Training, "_final_evaluation", lambda training: None)

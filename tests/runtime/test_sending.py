"""A bundle of work is done only by workers that read its format."""

import pytest

from armctl.runtime import workers
from armctl.runtime.sending import JobBundle
from armctl.runtime.workers import WorkersFailed, environment_of, run_isolated


def work(objects, unit):
    return objects


def test_bundles_of_another_format_are_refused_before_they_are_opened(monkeypatch):
    expected = environment_of(work) | {"bundles": 2}
    monkeypatch.setattr(workers, "_Child", None)
    with pytest.raises(WorkersFailed, match=r"differs, .*: bundles: 1 there, 2 here$"):
        run_isolated(work, JobBundle(b"", {}, (".",)), expected, (0,))

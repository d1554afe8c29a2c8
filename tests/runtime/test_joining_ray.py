import contextlib

import pytest

from armctl.core.errors import ConfigurationError
from armctl.runtime.engines import Ray

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("failures", "says"), [(3, None), (4, "no cluster of Ray answers at ray://a:1: .*failed")])
def test_a_head_that_starts_no_process_for_its_client_is_asked_again(failures, says, monkeypatch):
    ray = pytest.importorskip("ray")
    answers = [ConnectionError("Initialization failure: Starting Ray client server failed.")] * failures + [None]

    def init(*_, **__):
        if (answer := answers.pop(0)) is not None:
            raise answer

    monkeypatch.setattr(ray, "init", init)
    monkeypatch.setattr(ray, "cluster_resources", lambda: {"CPU": 2})
    with pytest.raises(ConfigurationError, match=says) if says else contextlib.nullcontext():
        assert Ray("ray://a:1").workers == 2
    assert len(answers) == (0 if says is None else 1)

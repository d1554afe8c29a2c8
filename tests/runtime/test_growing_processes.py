import os
import time

import pytest

from armctl.runtime import engines
from armctl.runtime.engines import Local


@pytest.mark.slow
def test_a_process_that_grows_by_what_policies_take_is_kept(monkeypatch):
    monkeypatch.setattr(engines, "MIN_GROWTH", 2 * 10**9)

    def grow(_: None, megabytes: int) -> int:
        vars(os).setdefault("kept", []).append(b"x" * 10**6 * megabytes)
        time.sleep(1.1)  # loky looks once a second
        return os.getpid()

    assert len(set(Local(2).run(grow, None, [(200,)] * 8))) == 2


def test_growth_is_a_share_of_memory_for_each_worker():
    assert engines.largest_growth(1) == pytest.approx(2 * engines.largest_growth(2), abs=1)
    assert engines.largest_growth(10**6) == engines.MIN_GROWTH

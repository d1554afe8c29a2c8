"""A worker of a cluster that returns something else than what it was asked for ends the work with a line."""

import pytest

from armctl.rollout.parallel import _play
from armctl.runtime.engines import Cluster
from armctl.runtime.workers import WorkersFailed


class Lying(Cluster):
    workers = 1

    def __init__(self, answer):
        self.answer = answer

    def count(self):
        return 1

    def _send(self, item):
        return item

    def _submit(self, common, unit):
        return unit

    def _wait(self, running):
        return running, []

    def _get(self, finished):
        return [self.answer for _ in finished]

    def _cancel(self, running):
        pass


@pytest.mark.parametrize("answer", ["nonsense", None, [("x",)], 5, object])
def test_a_lie_is_told(answer):
    with pytest.raises(WorkersFailed, match=f"a worker returned a {type(answer).__name__} in place of a RolloutBatch"):
        list(Lying(answer).run(_play, None, [("random",)]))

import resource
from contextlib import contextmanager

import numpy as np
import pytest

from armctl.errors import ResultsError
from armctl.report.videos import SIZE, _mp4

FRAMES = list(np.random.default_rng(0).integers(255, size=(12, *SIZE[::-1], 3), dtype=np.uint8))


@contextmanager
def disk(largest):
    """A disk that takes no file above a size."""
    before, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (largest, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (before, hard))


def test_half_a_video_is_none():
    whole = _mp4(FRAMES, 25)
    for largest in (0, 1000, len(whole) // 2, len(whole) - 1):
        with disk(largest), pytest.raises(ResultsError, match="the video of the report cannot be written"):
            _mp4(FRAMES, 25)
    with disk(2 * len(whole)):
        assert _mp4(FRAMES, 25) == whole

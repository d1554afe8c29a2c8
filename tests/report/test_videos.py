import numpy as np
import pytest

from armctl.core.errors import ResultsError
from armctl.report.videos import SIZE, _mp4

from ..command_line import full_disk

FRAMES = list(np.random.default_rng(0).integers(255, size=(12, *SIZE[::-1], 3), dtype=np.uint8))


@pytest.mark.slow
def test_half_a_video_is_none(sized):
    whole = _mp4(FRAMES, 25)
    for largest in sized((1000,), (0, 1000, len(whole) // 2, len(whole) - 1)):
        with full_disk(largest), pytest.raises(ResultsError, match="the video of the report cannot be written"):
            _mp4(FRAMES, 25)
    with full_disk(2 * len(whole)):
        assert _mp4(FRAMES, 25) == whole

"""Videos are written whole or not at all, whatever happens to the disk or the program."""

import imageio.v3 as imageio
import numpy as np
import pytest

from armctl.core.errors import ResultsError
from armctl.viewer.recording import VIDEO_FORMATS, check_frames, recording

from ..command_line import armctl

NOISE = np.random.default_rng(0).integers(255, size=(30, 96, 128, 3), dtype=np.uint8)


def record(path, frames=NOISE):
    said = []
    with recording(path, 25, said.append) as film:
        for frame in frames:
            film(frame)
    return said


@pytest.mark.slow
@pytest.mark.parametrize("suffix", VIDEO_FORMATS)
def test_a_video_has_every_frame_and_a_short_one_is_refused(tmp_path, suffix):
    path = tmp_path / f"film{suffix}"
    assert record(path) == [30]
    assert len(imageio.imread(path)) == 30
    assert [one.name for one in tmp_path.iterdir()] == [path.name]
    check_frames(path, 30, "film")
    with pytest.raises(ResultsError, match="the video film cannot be written: 30 of its 31 frames"):
        check_frames(path, 31, "film")
    half = path.read_bytes()[: path.stat().st_size // 2]
    for bytes_left in (half, b""):
        path.write_bytes(bytes_left)
        with pytest.raises(ResultsError, match="of its 30 frames arrived, as on a full disk"):
            check_frames(path, 30, "film")


@pytest.mark.slow
@pytest.mark.parametrize("interrupt", [KeyboardInterrupt, ResultsError])
def test_an_interrupted_video_has_what_was_filmed(tmp_path, interrupt):
    def frames():
        yield from NOISE[:7]
        raise interrupt

    with pytest.raises(interrupt):
        record(tmp_path / "film.mp4", frames())
    assert len(imageio.imread(tmp_path / "film.mp4")) == 7


def test_a_link_is_replaced_and_not_written_through(tmp_path):
    (tmp_path / "precious").write_text("mine")
    (tmp_path / "film.mp4").symlink_to(tmp_path / "precious")
    record(tmp_path / "film.mp4", NOISE[:3])
    assert (tmp_path / "precious").read_text() == "mine"
    assert len(imageio.imread(tmp_path / "film.mp4")) == 3


@pytest.mark.slow
@pytest.mark.parametrize(("disk", "steps"), [(9_000, 3), (20_000, 60)])
def test_a_full_disk_is_told_and_leaves_the_older_video(tmp_path, disk, steps):
    (tmp_path / "film.mp4").write_text("older")
    arguments = ["run", "random", "--steps", str(steps), "--video", "film.mp4"]
    done = armctl(*arguments, cwd=tmp_path, check=False, disk=disk)
    assert done.returncode == 2
    assert done.stderr.startswith("armctl: the video film.mp4 cannot be written: ")
    assert done.stderr.count("\n") == 1
    assert "frames\n" not in done.stdout
    assert (tmp_path / "film.mp4").read_text() == "older"
    assert [one.name for one in tmp_path.iterdir()] == ["film.mp4"]

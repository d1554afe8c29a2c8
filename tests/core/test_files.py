"""Checksums of files that may come from a stranger: no endless file is read, and no pipe is waited for."""

import hashlib
import os
from pathlib import Path

import pytest

from armctl.core.files import file_checksum, write_atomically


def test_a_checksum_is_that_of_the_whole_file(tmp_path):
    (tmp_path / "file").write_bytes(b"content" * 100_000)
    expected = hashlib.sha256(b"content" * 100_000).hexdigest()
    assert file_checksum(tmp_path / "file") == file_checksum(tmp_path / "file", 700_000) == expected


def test_a_file_that_is_too_large_is_not_read(tmp_path):
    with (tmp_path / "file").open("wb") as file:
        file.truncate(10**13)  # a hole, which takes no space, but would take hours to read
    with pytest.raises(ValueError, match="10,000,000,000,000 bytes, more than the 1,000"):
        file_checksum(tmp_path / "file", 1_000)


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero"), os.mkdir])
def test_what_is_no_regular_file_has_no_checksum(make, tmp_path):
    make(tmp_path / "file")
    with pytest.raises((ValueError, OSError), match=r"regular file|directory"):
        file_checksum(tmp_path / "file")


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(FileNotFoundError):
        file_checksum(tmp_path / "file")


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir], ids=["pipe", "folder"])
def test_what_is_no_regular_file_is_not_replaced(make, tmp_path):
    """A device neither: as root, a report replaced `/dev/zero`."""
    make(tmp_path / "report.html")
    before = (tmp_path / "report.html").lstat()
    with pytest.raises(FileExistsError, match="not a regular file"):
        write_atomically(tmp_path / "report.html", "content")
    assert (tmp_path / "report.html").lstat() == before
    assert len(list(tmp_path.iterdir())) == 1
    with pytest.raises(FileNotFoundError):
        write_atomically(tmp_path / "nowhere" / "report.html", "content")


def test_a_device_is_not_replaced():
    with pytest.raises(FileExistsError, match="not a regular file"):
        write_atomically(Path("/dev/zero"), "content")
    assert Path("/dev/zero").is_char_device()

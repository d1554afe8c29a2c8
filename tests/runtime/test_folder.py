"""A folder has one writer at a time, and holds what one identity has made."""

import json
import subprocess
import sys

import pytest

from armctl import __version__
from armctl.core.errors import ResultsError
from armctl.core.files import UNFINISHED, one_writer, sealed
from armctl.runtime.folder import claim

IDENTITY = {"seed": 0, "policies": ("a", "b"), "options": {"robot": "ur3"}}
HOLDING = """
import sys, time
from pathlib import Path
from armctl.core.files import one_writer
with one_writer(Path(sys.argv[1])):
    print("here", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "identity.json"
    path.write_text(sealed(IDENTITY))
    return path


def test_a_new_folder_is_free(tmp_path):
    assert claim(tmp_path / "identity.json", IDENTITY, "something else") is None


def test_the_same_identity_continues(file):
    assert claim(file, IDENTITY, "something else") == json.loads(json.dumps(IDENTITY))
    more = {"identity": IDENTITY, "episodes": 7}
    file.write_text(sealed(more))
    assert claim(file, IDENTITY, "something else")["episodes"] == 7


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"seed": 1}, r"holds another thing \(seed: 0 there, 1 here\): choose another folder, or overwrite it"),
        ({"options": {"robot": "ur10"}}, r"\(options: robot ur3 there, ur10 here\)"),
        ({"more": True}, r"\(more: None there, True here\)"),
        ({"seed": 1, "policies": ["a"]}, r"\(seed: 0 there, 1 here; policies: "),
    ],
)
def test_another_identity_is_refused_with_what_differs(file, change, says):
    with pytest.raises(ResultsError, match=says):
        claim(file, IDENTITY | change, "another thing")
    assert claim(file, IDENTITY, "another thing") is not None


@pytest.mark.parametrize("damage", [lambda text: "", lambda text: text[:-9], lambda text: text.replace("0", "1", 1)])
def test_a_damaged_identity_is_refused(file, damage):
    file.write_text(damage(file.read_text()))
    with pytest.raises(ResultsError, match=r"is damaged \(.*\): delete it"):
        claim(file, IDENTITY, "another thing", "delete it")


@pytest.mark.parametrize(("stored", "has"), [({"format": 2}, "format 2"), ({}, "no format number")])
def test_another_format_is_refused_with_the_version_that_writes_this_one(file, stored, has):
    file.write_text(sealed(stored | {"identity": IDENTITY}))
    with pytest.raises(ResultsError, match=rf"it has {has}; armctl {__version__} writes and reads format 1: use"):
        claim(file, IDENTITY, "another thing", format_number=1)
    file.write_text(sealed({"format": 1, "identity": IDENTITY}))
    assert claim(file, IDENTITY, "another thing", format_number=1)["format"] == 1


@pytest.mark.parametrize("content", ["[1, 2]", sealed({"identity": 3}), "{" * 100_000])
def test_a_file_of_a_stranger_gives_no_traceback(file, content):
    file.write_text(content)
    with pytest.raises(ResultsError, match=r"is damaged"):
        claim(file, IDENTITY, "another thing")


def test_what_is_no_file_is_refused(tmp_path):
    (tmp_path / "identity.json").mkdir()
    with pytest.raises(ResultsError, match="cannot be read"):
        claim(tmp_path / "identity.json", IDENTITY, "another thing")


@pytest.mark.slow
def test_a_killed_writer_frees_the_folder_and_what_it_left_unfinished_goes(tmp_path):
    holder = subprocess.Popen([sys.executable, "-c", HOLDING, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout.readline() == "here\n"
        with pytest.raises(ResultsError, match="another process writes to"), one_writer(tmp_path):
            pass
    finally:
        holder.kill()
        holder.wait()
    left = tmp_path / f"{UNFINISHED}half.json"
    left.touch()
    with one_writer(tmp_path):
        assert not left.exists()


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ResultsError, match="cannot be written to"), one_writer(tmp_path / "file" / "folder"):
        pass

"""What a tuning's folder holds may come from a stranger, or from a process that died: it is data, and is checked."""

import json
import os
import pickle
import shutil
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armctl.core.errors import ArmctlError, ResultsError
from armctl.tuning import candidate_of, tune
from armctl.tuning.journal import JOURNAL

from .small_tunings import RECIPE, expert


def records(folder):
    return [json.loads(line) for line in (folder / JOURNAL).read_text().splitlines()]


def write(folder, changed):
    (folder / JOURNAL).write_text("".join(json.dumps(record) + "\n" for record in changed))


def places(value, path=()):
    """Yield the path of every value within JSON values."""
    yield path
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from places(inner, (*path, key))


VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**70), 2**70), st.floats(), st.text(max_size=9),
    st.lists(st.integers(-2, 2), max_size=2), st.just({}), st.sampled_from(["../../elsewhere", "0000", "1e999"]),
)  # fmt: skip


@pytest.mark.slow
@settings(max_examples=40)
@given(data=st.data())
def test_any_journal_is_refused_or_works(one_trial, tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("mutated") / "tuning"
    shutil.copytree(one_trial, folder)
    changed = records(folder)
    at = data.draw(st.integers(0, len(changed) - 1))
    *above, last = data.draw(st.sampled_from(list(places(changed[at]))[1:]))
    inner = changed[at]
    for key in above:
        inner = inner[key]
    inner[last] = data.draw(VALUES)
    write(folder, changed)
    try:
        outcome = tune(expert(), folder, trials=1)
    except ArmctlError:
        return
    assert all(value in expert().space[path] for trial in outcome.trials for path, value in trial.params.items())


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"folder": "0000"', '"folder": "../../elsewhere"', "notes of trial 0"),
        ('"folder": "0000"', '"folder": "/tmp"', "notes of trial 0"),
        ('"directions": [2]', '"directions": [1]', "minimises"),
        ('"processor_seconds": ', '"processor_seconds": -', "notes of trial"),
        ('"scores": [', '"scores": ["', "damaged"),
    ],
)
def test_what_armctl_does_not_write_is_refused(begun, old, new, says):
    text = (begun / JOURNAL).read_text()
    compact = {part: part.replace(": ", ":").replace(", ", ",") for part in (old, new)}
    if old not in text:
        old, new = compact[old], compact[new]
    assert old in text
    (begun / JOURNAL).write_text(text.replace(old, new))
    with pytest.raises(ResultsError, match=says):
        tune(expert(), begun, trials=2)


def test_values_beyond_their_range_are_refused(begun):
    path = next(path for path, value_range in expert().space.items() if not value_range.choices)
    changed = records(begun)
    for record in changed:
        if record.get("param_name") == path:
            record["param_value_internal"] = 1e9
    write(begun, changed)
    with pytest.raises(ResultsError, match="outside its range"):
        tune(expert(), begun, trials=2)


@pytest.mark.parametrize("relative", [False, True])
def test_a_lock_that_outlived_its_process_is_removed(begun, relative, monkeypatch):
    folder = begun
    if relative:
        monkeypatch.chdir(begun.parent)
        folder = Path(begun.name)
    os.symlink(JOURNAL if relative else folder / JOURNAL, folder / f"{JOURNAL}.lock")
    assert len(tune(expert(), folder, trials=1).trials) == 1
    assert not os.path.lexists(folder / f"{JOURNAL}.lock")


class Planted:
    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


@pytest.mark.slow
def test_a_planted_checkpoint_is_not_loaded(tmp_path):
    (tmp_path / "small.toml").write_text(RECIPE)
    candidate = candidate_of(str(tmp_path / "small.toml"), training_seeds=1)
    tune(candidate, tmp_path / "own", trials=1)
    planted = tmp_path / "out/trials/0000"
    shutil.copytree(tmp_path / "own/trials/0000", planted)
    (planted / "seed-1000/agent.json").unlink()
    checkpoints = [file for file in planted.rglob("*") if file.suffix in (".pt", ".zip", ".pkl")]
    assert checkpoints
    for file in checkpoints:
        file.write_bytes(pickle.dumps(Planted(tmp_path / "ran")))
    outcome = tune(candidate, tmp_path / "out", trials=1)
    assert not (tmp_path / "ran").exists()
    assert outcome.best is not None
    assert outcome.trials[0].user_attrs["folder"].startswith("0000-")

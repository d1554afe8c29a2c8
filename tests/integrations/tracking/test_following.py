"""What trackers are told of a training by any learner, and that whatever they do harms no training."""

import contextlib
import json
import time

import pandas as pd
import pytest

from armctl.core.errors import ConfigurationError
from armctl.core.files import sealed
from armctl.integrations.tracking import Tracker, following, tracked
from armctl.study.curves import CURVE_COLUMNS
from armctl.training.learners import Recipe

RECIPE = Recipe(name="mine", learner="foreign", env="armctl/ArmReach-v0", options={"gamma": 0.9})


class Notes(Tracker):
    """A tracker that notes what it is told."""

    told: list = []

    def __init__(self, name, folder, config, run):
        self.run, self.where = run or "first", "here"
        self.told.append(("begin", name, config, run))

    def log(self, steps, values):
        self.told.append(("log", steps, values))

    def agent(self, files):
        self.told.append(("agent", [file.name for file in files]))

    def video(self, file, steps):
        self.told.append(("video", file, steps))

    def finish(self, ending):
        self.told.append(("finish", ending))


class Failing(Notes):
    def log(self, steps, values):
        raise SystemExit("the server\nsaid no")


class Hanging(Notes):
    def log(self, steps, values):
        time.sleep(60)


@pytest.fixture
def follow(tmp_path, monkeypatch):
    """Follow a training in `tmp_path` by trackers of these kinds; what is said to the user, and its `on_evaluation`."""
    monkeypatch.setattr(following, "PATIENCE", 0.3)
    monkeypatch.setattr(Notes, "told", [])

    @contextlib.contextmanager
    def follow(*kinds, resume=False):
        named = {kind.__name__.lower(): kind for kind in kinds}
        monkeypatch.setattr(following, "load_tracker", named.__getitem__)
        said: list[str] = []
        with tracked(list(named), RECIPE, tmp_path, 3, resume, said.append) as on_evaluation:
            yield said, on_evaluation

    return follow


def write_curve(folder, *steps, on_evaluation=lambda row: None):
    """As a learner of another package does, which writes nothing else before the end."""
    curve = pd.DataFrame({name: [float(k) for k in steps] for name in CURVE_COLUMNS})
    curve.to_csv(folder / "curve.csv", index=False)
    on_evaluation(curve.iloc[-1])


def logged():
    return [told[1] for told in Notes.told if told[0] == "log"]


def until(condition):
    end = time.monotonic() + 120
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_rows_arrive_while_a_learner_learns(follow, tmp_path):
    with contextlib.suppress(ValueError), follow(Notes) as (said, on_evaluation):
        write_curve(tmp_path, 0, 10, on_evaluation=on_evaluation)
        until(lambda: logged() == [0, 10])
        write_curve(tmp_path, 0, 10, 20)  # and nobody is told
        raise ValueError("the learner fails")
    begin, *_, last = Notes.told
    assert begin[1] == tmp_path.name
    assert (begin[2]["options"], begin[2]["seed"]) == ({"gamma": 0.9}, 3)
    assert logged() == [0, 10, 20]
    assert Notes.told[-2][2] == dict.fromkeys(CURVE_COLUMNS[1:], 20.0), "what is unknown (NaN) is left out"
    assert last == ("finish", "failed")
    assert said == ["Tracking by notes: here"]


def test_a_resumed_training_continues_its_run(follow, tmp_path):
    with contextlib.suppress(KeyboardInterrupt), follow(Notes):
        write_curve(tmp_path, 0, 10)
        raise KeyboardInterrupt
    assert Notes.told[-1] == ("finish", "interrupted")
    with contextlib.suppress(KeyboardInterrupt), follow(Notes, resume=True):
        write_curve(tmp_path, 0, 10, 20)
        raise KeyboardInterrupt
    assert [told[3] for told in Notes.told if told[0] == "begin"] == [None, "first"]
    assert logged() == [0, 10, 20]


def test_a_training_that_is_refused_leaves_no_run(follow, tmp_path):
    write_curve(tmp_path, 0)
    before = sorted(tmp_path.iterdir())
    for resume in (False, True):
        with pytest.raises(ConfigurationError), follow(Notes, resume=resume) as (said, _):
            raise ConfigurationError("no such robot")
        assert (said, Notes.told) == ([], [])
    assert sorted(tmp_path.iterdir()) == before


def test_a_tracker_that_fails_or_hangs_is_told_of_once_and_harms_nobody(follow, tmp_path):
    with contextlib.suppress(KeyboardInterrupt), follow(Failing, Hanging, Notes) as (said, on_evaluation):
        write_curve(tmp_path, 0, on_evaluation=on_evaluation)
        until(lambda: logged() == [0])
        write_curve(tmp_path, 0, 10)
        raise KeyboardInterrupt
    assert logged() == [0, 10]
    assert len(said) == 3, said
    assert "\n" not in "".join(said)
    assert any("failing failed" in one and "the server said no" in one and "--resume" in one for one in said)
    assert any("hanging did not end within 0.3 s" in one for one in said)
    assert "Tracking by notes: here" in said


def test_a_tracker_that_failed_catches_up(follow, tmp_path):
    with contextlib.suppress(KeyboardInterrupt), follow(Failing):
        write_curve(tmp_path, 0, 10)
        raise KeyboardInterrupt
    (tmp_path / "tracking" / "failing.json").rename(tmp_path / "tracking" / "notes.json")
    with contextlib.suppress(KeyboardInterrupt), follow(Notes, resume=True):
        write_curve(tmp_path, 0, 10, 20)
        raise KeyboardInterrupt
    assert logged() == [0, 10, 20]


@pytest.mark.parametrize(
    ("content", "says"),
    [("{", "Expecting"), (sealed({"format": 2, "run": "1", "steps": 0}), "it has format 2; armctl")],
    ids=["damaged", "another format"],
)
def test_an_unusable_note_ends_the_tracking_alone(follow, tmp_path, content, says):
    (tmp_path / "tracking").mkdir()
    (tmp_path / "tracking" / "notes.json").write_text(content)
    with contextlib.suppress(KeyboardInterrupt), follow(Notes, resume=True) as (said, _):
        write_curve(tmp_path, 0)
        raise KeyboardInterrupt
    assert ["Tracking by notes failed" in one and says in one for one in said] == [True]


def test_nothing_is_written_through_a_link_that_leads_elsewhere(follow, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (tmp_path / "tracking").symlink_to(elsewhere)
    with follow(Notes) as (said, _):
        write_curve(tmp_path, 0)
    assert [one.partition(": ")[0] for one in said] == [
        "There is no video of the agent",
        "Tracking by notes failed, which does not affect the training",
    ]
    assert not list(elsewhere.iterdir())


def test_an_agent_that_cannot_be_filmed_is_handed_over_without_a_video(follow, tmp_path):
    card = {"damaged": True}
    with follow(Notes) as (said, _):
        (tmp_path / "agent.json").write_text(json.dumps(card))
    assert any(one.startswith("There is no video of the agent: ") for one in said)
    assert all("\n" not in one for one in said)


def test_a_training_that_has_begun_and_is_refused_later_has_failed(follow, tmp_path):
    with contextlib.suppress(ConfigurationError), follow(Notes) as (_, on_evaluation):
        write_curve(tmp_path, 0, on_evaluation=on_evaluation)
        raise ConfigurationError("no such robot")
    assert Notes.told[-1] == ("finish", "failed")


def test_an_interrupt_before_a_training_has_begun_leaves_no_run(follow, tmp_path):
    with contextlib.suppress(KeyboardInterrupt), follow(Notes) as (said, _):
        raise KeyboardInterrupt
    assert (said, Notes.told) == ([], [])
    assert not list(tmp_path.iterdir())

import csv
import shutil

import pytest

from armctl.agents import read_card
from armctl.errors import ConfigurationError
from armctl.evaluation.trials import COLUMNS, read_trials, write_trials
from armctl.rl import zoo
from armctl.rl.publish import publish

AGENTS = zoo.HOME / "agents"


def training(folder, seed, success, name="reach_bc", steps=None):
    """A folder as `armctl train` leaves it, of a shipped agent but for its seed and its success."""
    folder.mkdir(parents=True)
    card = read_card(AGENTS / f"{name}.json")
    evaluation = card.evaluation.model_copy(update={"success_rate": success})
    changed = {"training_seed": seed, "evaluation": evaluation}
    if steps is not None:
        changed["learner_options"] = card.learner_options | {"steps": steps}
    (folder / "agent.json").write_text(card.model_copy(update=changed).model_dump_json())
    shutil.copy(AGENTS / f"{name}.onnx", folder / "agent.onnx")
    (folder / "curve.csv").write_text(f"curve of seed {seed}")
    new = not (folder.parent / "trials.csv").exists()
    with (folder.parent / "trials.csv").open("a", newline="") as file:
        rows = csv.DictWriter(file, COLUMNS)
        if new:
            rows.writeheader()
        rows.writerow({"date": "2026-01-01T00:00:00+00:00", "recipe": name, "seed": seed, "success": success})
    return folder


@pytest.fixture
def home(tmp_path):
    """A zoo without agents."""
    (tmp_path / "zoo" / "agents" / "seeds").mkdir(parents=True)
    write_trials(tmp_path / "zoo" / "trials.csv", [])
    return tmp_path / "zoo"


def shipped(home, name="reach_bc"):
    return read_card(home / "agents" / f"{name}.json").training_seed


def others(home):
    return sorted(path.name for path in (home / "agents" / "seeds").iterdir())


def files(stem):
    return [f"{stem}.csv", f"{stem}.json", f"{stem}.onnx"]


def test_the_median_one_is_shipped_and_the_others_are_kept(home, tmp_path):
    folders = [training(tmp_path / "runs" / str(seed), seed, success) for seed, success in enumerate((0.9, 0.7, 0.8))]
    assert publish(folders, home) == home / "agents" / "reach_bc.json"
    assert shipped(home) == 2
    assert others(home) == files("reach_bc-0") + files("reach_bc-1")
    assert (home / "agents" / "reach_bc.csv").read_text() == "curve of seed 2"
    assert read_card(home / "agents" / "seeds" / "reach_bc-1.json").name == "reach_bc-1"


def test_a_later_seed_may_be_the_median_of_all(home, tmp_path):
    publish([training(tmp_path / "runs" / "0", 0, 0.9)], home)
    publish([training(tmp_path / "runs" / "1", 1, 0.7)], home)
    assert shipped(home) == 1  # of two, the worse one
    publish([training(tmp_path / "runs" / "2", 2, 0.8)], home)
    assert shipped(home) == 2
    assert others(home) == files("reach_bc-0") + files("reach_bc-1")


def test_agents_trained_with_other_options_are_replaced(home, tmp_path):
    publish([training(tmp_path / "runs" / str(seed), seed, 0.9) for seed in (0, 1)], home)
    publish([training(tmp_path / "later" / "5", 5, 0.5, steps=7)], home)
    assert shipped(home) == 5
    assert others(home) == []


def test_trials_are_added_once(home, tmp_path):
    folders = [training(tmp_path / "runs" / str(seed), seed, 0.5) for seed in (0, 1)]
    for _ in range(2):
        publish(folders, home)
    rows = read_trials(home / "trials.csv")
    assert [(row["date"], row["seed"]) for row in rows] == [("2026-01-01", "0"), ("2026-01-01", "1")]


def test_several_recipes_are_refused_and_nothing_is_changed(home, tmp_path):
    folders = [training(tmp_path / "runs" / "0", 0, 0.9), training(tmp_path / "runs" / "1", 0, 0.9, "reach_dagger")]
    with pytest.raises(ConfigurationError, match="same recipe"):
        publish(folders, home)
    assert list((home / "agents").iterdir()) == [home / "agents" / "seeds"]

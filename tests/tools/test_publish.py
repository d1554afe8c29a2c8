import csv
import shutil

import pytest
import zoo
from publish import publish

from armctl.agents import read_card
from armctl.core.errors import ArmctlError, ConfigurationError
from armctl.training.trials import COLUMNS, add_trial, read_trials, write_trials

AGENTS = zoo.HOME / "agents"


def training(folder, seed, success, name="reach_bc", **options):
    """A folder as `armctl train` leaves it: a shipped agent's, with a seed, a success and options (None: unknown)."""
    folder.mkdir(parents=True)
    card = read_card(AGENTS / f"{name}.json")
    evaluation = card.evaluation.model_copy(update={"success_rate": success})
    known = {key: value for key, value in (card.learner_options | options).items() if value is not None}
    changed = {"training_seed": seed, "evaluation": evaluation, "development": None, "learner_options": known}
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


def contents(home):
    return {path: path.read_bytes() for path in home.rglob("*") if path.is_file()}


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


def test_the_median_is_chosen_in_development_whatever_the_sealed_test_said(home, tmp_path):
    folders = [training(tmp_path / "runs" / str(seed), seed, success) for seed, success in enumerate((0.9, 0.7, 0.8))]
    for folder, sealed in zip(folders, (0.8, 0.9, 0.7), strict=True):
        card = read_card(folder / "agent.json")
        played = card.evaluation.model_copy(update={"success_rate": sealed})
        changed = card.model_copy(update={"evaluation": played, "development": card.evaluation})
        (folder / "agent.json").write_text(changed.model_dump_json())
    publish(folders, home)
    assert shipped(home) == 2
    assert read_card(home / "agents" / "reach_bc.json").evaluation.success_rate == 0.7


def test_a_later_seed_may_be_the_median_of_all(home, tmp_path):
    publish([training(tmp_path / "runs" / "0", 0, 0.9)], home)
    publish([training(tmp_path / "runs" / "1", 1, 0.7)], home)
    assert shipped(home) == 1  # of two, the worse one
    publish([training(tmp_path / "runs" / "2", 2, 0.8)], home)
    assert shipped(home) == 2
    assert others(home) == files("reach_bc-0") + files("reach_bc-1")


def test_agents_trained_with_other_options_are_replaced_only_if_asked(home, tmp_path):
    publish([training(tmp_path / "runs" / str(seed), seed, 0.9) for seed in (0, 1)], home)
    other = training(tmp_path / "later" / "5", 5, 0.5, steps=7)
    before = contents(home)
    with pytest.raises(ConfigurationError, match="steps"):
        publish([other], home)
    assert contents(home) == before
    publish([other], home, replace=True)
    assert shipped(home) == 5
    assert others(home) == []


def test_options_that_older_versions_did_not_have_do_not_count(home, tmp_path):
    publish([training(tmp_path / "runs" / "0", 0, 0.9, layers=None)], home)
    publish([training(tmp_path / "runs" / "1", 1, 0.7)], home)
    assert others(home) == files("reach_bc-0")


def test_trials_are_added_once(home, tmp_path):
    folders = [training(tmp_path / "runs" / str(seed), seed, 0.5) for seed in (0, 1)]
    for _ in range(2):
        publish(folders, home)
    rows = read_trials(home / "trials.csv")
    assert [(row["date"], row["seed"]) for row in rows] == [("2026-01-01", "0"), ("2026-01-01", "1")]


def test_trainings_that_failed_at_the_same_step_are_all_recorded(home, tmp_path):
    folder = training(tmp_path / "runs" / "0", 0, 0.5)
    failed = {"date": "2026-01-02", "recipe": "reach_bc", "seed": 0, "steps": 9, "ended": "failed"}
    for changed in ("a", "b"):
        add_trial(folder.parent / "trials.csv", failed | {"changed": changed})
    publish([folder], home)
    assert [row["changed"] for row in read_trials(home / "trials.csv")] == ["", "a", "b"]


def two_recipes(folder):
    return [training(folder / "0", 0, 0.9), training(folder / "1", 1, 0.9, "reach_dagger")]


def one_seed_twice(folder):
    return [training(folder / "0", 0, 0.9), training(folder / "1", 0, 0.9)]


def unfinished(folder):
    made = training(folder / "0", 0, 0.9)
    card = read_card(made / "agent.json")
    (made / "agent.json").write_text(card.model_copy(update={"evaluation": None}).model_dump_json())
    return [made]


def another_network(folder):
    made = training(folder / "0", 0, 0.9)
    (made / "agent.onnx").write_bytes(b"another")
    return [made]


def own_recipe(folder):
    made = training(folder / "0", 0, 0.9)
    card = read_card(made / "agent.json")
    (made / "agent.json").write_text(card.model_copy(update={"recipe": "../mine"}).model_dump_json())
    return [made]


@pytest.mark.parametrize(
    ("made", "why"),
    [
        (two_recipes, "differ only in their seed"),
        (one_seed_twice, "both of training seed 0"),
        (unfinished, "not of a finished training"),
        (another_network, "was changed"),
        (own_recipe, "no recipe of armctl"),
    ],
)
def test_what_cannot_be_published_changes_nothing(home, tmp_path, made, why):
    publish([training(tmp_path / "runs" / "7", 7, 0.9)], home)
    before = contents(home)
    with pytest.raises(ArmctlError, match=why):
        publish(made(tmp_path / "later"), home)
    assert contents(home) == before

import importlib
import re
import sys
from importlib import resources
from pathlib import Path

import pytest

from armctl.core.errors import ConfigurationError
from armctl.core.registration import environment_names
from armctl.training.learners import Recipe, learner_names, load_exporter, load_learner, load_recipe, recipe_names

GOOD = 'learner = "ppo"\nenv = "armctl/ArmReach-v0"\n'


@pytest.fixture
def recipe_file(tmp_path):
    def write(text):
        path = tmp_path / "mine.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


@pytest.mark.parametrize("name", recipe_names())
def test_a_shipped_recipe_can_be_followed(name):
    from armctl.rl.run.options import TrainingOptions

    recipe = load_recipe(name)
    assert recipe.env in environment_names()
    learner = load_learner(recipe.learner)
    module = [it for it in vars(importlib.import_module(learner.__module__)).values() if isinstance(it, type)]
    (kind,) = (it for it in module if issubclass(it, TrainingOptions) and it.__module__ == learner.__module__)
    assert recipe.read_options(kind).steps == recipe.options["steps"]


@pytest.mark.parametrize("name", sorted({load_recipe(name).learner: name for name in recipe_names()}.values()))
def test_a_shipped_learner_hands_its_callback_to_the_training(name, tmp_path, monkeypatch):
    from armctl.rl.run.training import Training

    class Seen(Exception):
        """The callback has arrived."""

    def begin(training, recipe, options, out, seed, resume, callback, progress):
        callback({})

    def raise_seen(row):
        raise Seen

    monkeypatch.setattr(Training, "__init__", begin)
    recipe = load_recipe(name)
    with pytest.raises(Seen):
        load_learner(recipe.learner)(recipe, out=tmp_path, seed=0, on_evaluation=raise_seen)


def test_what_is_shipped():
    assert {"reach_ppo", "bridge_ppo", "bridge_moving_state_ppo", "reach_sac"} <= set(recipe_names())
    assert {"ppo", "sac"} <= set(learner_names())


def test_recipes_are_package_data():
    files = {file.name for file in resources.files("armctl.rl.recipes").iterdir()}
    assert {f"{name}.toml" for name in recipe_names()} <= files


def test_a_recipe_is_found_by_name_file_or_learner(recipe_file):
    assert load_recipe("reach_ppo").name == "reach_ppo"
    assert load_recipe("ppo").name == "reach_ppo"
    assert load_recipe("ppo", "armctl/BridgeCross-v0").name == "bridge_depth_ppo"
    assert load_recipe("ppo", "mine:mine/Task-v0") == Recipe(name="ppo", learner="ppo", env="mine:mine/Task-v0")
    mine = load_recipe(recipe_file(GOOD + "[options]\nsteps = 5\n"))
    assert (mine.name, mine.learner, mine.options, mine.seeds) == ("mine", "ppo", {"steps": 5}, [0])
    assert load_recipe(str(recipe_file(GOOD)), "armctl/BridgeCross-v0").env == "armctl/BridgeCross-v0"


@pytest.mark.parametrize(
    ("name", "env", "says"),
    [
        ("reach_pp", None, "Did you mean 'reach_ppo'"),
        ("", None, "there is no recipe ''"),
        ("pppo", None, "Did you mean 'ppo'"),
        ("nowhere/mine.toml", None, "cannot be read: No such file"),
    ],
)
def test_what_is_not_found_is_named_with_the_nearest(name, env, says):
    with pytest.raises(ConfigurationError, match=re.escape(says)):
        load_recipe(name, env)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "learner: Field required"),
        ('learner = "ppo"', "env: Field required"),
        (GOOD + 'shapping = "ik"', "Did you mean 'shaping'"),
        (GOOD + 'shaping_scale = "5"', "shaping_scale: Input should be a valid number"),
        (GOOD + "shaping_scale = nan", "shaping_scale: Input should be a finite number"),
        (GOOD + "reward_weights = { goal = inf }", "reward_weights.goal"),
        (GOOD + "reward_weights = [1.0]", "reward_weights: Input should be a valid dictionary"),
        (GOOD + "training_options = 0.1", "training_options: Input should be a valid dictionary"),
        (GOOD + "[[curriculum]]\nafter = 1.0", "curriculum.0.after"),
        (GOOD + "[[curriculum]]\nbefore = 0.5", "curriculum.0"),
        (GOOD + "[[curriculum]]\nafter = 0.5\n[[curriculum]]\nafter = 0.4", "in the order in which they begin"),
        (GOOD + "seeds = []", "seeds"),
        (GOOD + "seeds = [-1]", "seeds.0"),
        (GOOD + "seeds = [true]", "seeds.0"),
        (GOOD + "options = 3", "options: Input should be a valid dictionary"),
        (GOOD + "teacher = 1", "teacher: Input should be a valid string"),
        ("learner = ", "is not TOML"),
        (b"\x80\x04cos\nsystem", "is not TOML"),
    ],
)
def test_a_spoilt_recipe_says_what_is_wrong(recipe_file, text, says):
    path = recipe_file(text)
    with pytest.raises(ConfigurationError, match=re.escape(says)) as caught:
        load_recipe(path)
    assert "mine.toml" in str(caught.value)


def test_a_folder_is_no_recipe(tmp_path):
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(ConfigurationError, match="cannot be read"):
        load_recipe(tmp_path / "folder.toml")


def test_a_changed_recipe_is_checked_too():
    recipe = load_recipe("reach_ppo")
    assert recipe.changed(shaping=None).shaping is None
    assert recipe.shaping == "ik"
    with pytest.raises(ConfigurationError, match="seeds"):
        recipe.changed(seeds=["one"])
    with pytest.raises(ConfigurationError, match="Did you mean 'teacher'"):
        recipe.changed(techer="reach_ik")


def test_an_unknown_learner():
    with pytest.raises(ConfigurationError, match="Did you mean 'ppo'"):
        load_learner("pppo")


def test_an_exporter_is_found_by_the_model_s_suffix(monkeypatch):
    assert load_exporter(Path("some/model.zip")).__module__ == "armctl.rl.export.sb3"
    with pytest.raises(ConfigurationError, match=r"model\.pt cannot be exported: models are files \.zip"):
        load_exporter(Path("model.pt"))
    monkeypatch.setitem(sys.modules, "armctl.rl.export.sb3", None)
    with pytest.raises(ConfigurationError, match=r"pip install 'armctl-suite\[rl\]'"):
        load_exporter(Path("model.zip"))

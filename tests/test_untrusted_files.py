"""Files from strangers, whose code would leave a mark: it is never run."""

import json
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

import armctl as armctl_package
from armctl.core.errors import ConfigurationError
from armctl.core.registration import check_named
from armctl.policies.trainings import card_path
from armctl.study import compare
from armctl.study.reproduce import reproduce
from armctl.training.learners import load_recipe

from .command_line import armctl, program
from .forgery import forge, rewrite
from .stores import read_cell

EVIL = "from pathlib import Path\nPath(__file__ + '.ran').touch()\n"
OPTIONS = {"max_episode_steps": 5}


@pytest.fixture
def home(tmp_path):
    """A folder with hostile modules, some of which have the names of libraries that are often looked for."""
    for name in ("evil", "orjson", "ujson", "kaleido", "IPython", "ompl_extra", "sitecustomize", "tomli", "lxml"):
        (tmp_path / f"{name}.py").write_text(EVIL)
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "__init__.py").touch()
    (tmp_path / "results" / "evil.py").write_text(EVIL)
    return tmp_path


def marks(home):
    return [path.name for path in home.rglob("*.ran")]


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    folder = tmp_path_factory.mktemp("played")
    compare(["random", "reach_ik"], episodes=2, out=folder, env_options=OPTIONS)
    return folder


@pytest.fixture
def results(home, played):
    return shutil.copytree(played, home / "results", dirs_exist_ok=True)


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("there", "hostile"),
    [
        ("armctl/ArmReach-v0", "evil.py:armctl/ArmReach-v0"),
        ("random", "evil.py:make"),
        *(
            pytest.param(there, hostile, marks=pytest.mark.slow)
            for there, hostile in [
                ("armctl/ArmReach-v0", "evil:armctl/ArmReach-v0"),
                ("armctl/ArmReach-v0", "results.evil:armctl/x.json"),
                ("armctl/ArmReach-v0", "results/evil.py:Maze"),
                ("random", "evil:make"),
                ("random", "results.evil:make"),
                ("random", "evil:armctl/x.json"),
            ]
        ),
    ],
)
def test_a_results_folder_runs_no_code(home, results, there, hostile):
    forge(results, there, hostile)
    new_process = hostile in ("evil:armctl/ArmReach-v0", "evil:make")  # one for each of the two that are forged
    done = (program if new_process else armctl)("report", "results", cwd=home)
    assert marks(home) == []
    assert (results / "report.html").exists(), done.stderr


@pytest.fixture
def agent(home):
    card = card_path("reach_ppo")
    for suffix in (".json", ".onnx"):
        shutil.copy(card.with_suffix(suffix), home / f"agent{suffix}")
    return home / "agent.json"


RUNS = """
from subprocess import run
from gymnasium.envs.classic_control import PendulumEnv

class Maze(PendulumEnv):
    pass
"""


@pytest.mark.slow
def test_to_name_one_thing_of_a_module_is_not_to_name_another(home, results):
    (home / "mine.py").write_text(RUNS)
    identity, facts, runs, episodes = read_cell(results)
    identity["env"] = "mine.py:run"
    identity["env_options"] = facts["env_options"] = {"args": "touch evil.ran", "shell": "True"}
    rewrite(results, identity, facts, [replace(one, env="run") for one in episodes], runs)
    program("report", "results", "--env", "mine.py:Maze", cwd=home)
    assert marks(home) == []
    assert "--env mine.py:run" in (results / "report.html").read_text()


def test_a_text_for_an_environment_of_others_may_be_a_path(home, agent):
    """As in `xml_file` of Gymnasium's own: the parser of MuJoCo would open it."""
    card = json.loads(agent.read_text()) | {"env": "Ant-v5", "env_options": {"xml_file": str(home / "pipe.xml")}}
    os.mkfifo(home / "pipe.xml")
    agent.write_text(json.dumps(card))
    with pytest.raises(ConfigurationError, match="--env Ant-v5"):
        reproduce(agent)


@pytest.mark.slow
def test_a_report_says_how_to_run_code_that_one_trusts(home, results):
    (home / "mine.py").write_text("def still(observation):\n    return observation[3:9]\n")
    armctl("compare", "mine.py:still", "--episodes", "2", "--out", "own", "--set", "max_episode_steps=5", cwd=home)
    program("report", "own", cwd=home)  # in a process in which that was not named
    page = (home / "own" / "report.html").read_text()
    assert "name it yourself, --policy mine.py:still" in page
    armctl("report", "own", "--policy", "mine.py:still", cwd=home)
    page = (home / "own" / "report.html").read_text()
    assert "name it yourself" not in page
    assert "data:video/mp4" in page


@pytest.mark.slow
def test_a_folder_in_which_one_works_runs_no_code(home, results):
    """`import orjson` inside a library finds no file of the working directory."""
    program("report", ".", cwd=results.parent, check=False)
    for name in ("orjson", "kaleido"):
        (results / f"{name}.py").write_text(EVIL)
    program("report", ".", "--no-video", cwd=results)
    program("list", cwd=results)
    program("compare", "random", "--episodes", "1", "--out", "more", "--report", cwd=results)
    assert marks(home) == []


@pytest.mark.one_case
@pytest.mark.parametrize(
    "env",
    [pytest.param("evil:armctl/ArmReach-v0", marks=pytest.mark.slow), "evil.py:ArmReach-v0", "results.evil:x"],
)
def test_a_card_runs_no_code(home, agent, env):
    agent.write_text(json.dumps(json.loads(agent.read_text()) | {"env": env}))
    new_process = env == "evil:armctl/ArmReach-v0"
    done = (program if new_process else armctl)("reproduce", "agent.json", cwd=home, check=False)
    assert done.returncode == 2
    assert f"--env {env}" in done.stderr
    assert marks(home) == []
    armctl("compare", "agent.json", "--episodes", "1", "--out", "own", cwd=home)
    assert marks(home) == []


def test_an_environment_that_is_not_the_cards(agent):
    with pytest.raises(ConfigurationError, match="of an agent for armctl/ArmReach-v0"):
        reproduce(agent, env="armctl/BridgeCross-v0")


def recipe_text(**changes):
    values = {"learner": "ppo", "env": "armctl/ArmReach-v0"} | changes
    return "".join(f"{name} = {json.dumps(value)}\n" for name, value in values.items())


@pytest.mark.parametrize(
    ("changes", "option"),
    [
        pytest.param({"env": "evil:armctl/ArmReach-v0"}, "--env evil:armctl/ArmReach-v0", marks=pytest.mark.slow),
        ({"env": "evil.py:Maze"}, "--env evil.py:Maze"),
        ({"learner": "dagger", "teacher": "evil:make"}, "--teacher evil:make"),
        ({"learner": "bc", "teacher": "results/evil.py:make"}, "--teacher results/evil.py:make"),
    ],
)
def test_a_recipe_runs_no_code(home, changes, option):
    (home / "recipe.toml").write_text(recipe_text(**changes))
    new_process = changes == {"env": "evil:armctl/ArmReach-v0"}
    done = (program if new_process else armctl)("train", "recipe.toml", cwd=home, check=False)
    assert done.returncode == 2
    assert option in done.stderr
    assert marks(home) == []
    assert not (home / "runs").exists()


@pytest.mark.parametrize("name", ["../../escaped", "/tmp/escaped", "a/b", "", "..", "x" * 300, "a\nb", "\x1b[2J"])
def test_the_name_of_a_recipe_leads_nowhere(home, name):
    (home / "recipe.toml").write_text(recipe_text(name=name))
    with pytest.raises(ConfigurationError, match="cannot be the name of a recipe"):
        load_recipe(home / "recipe.toml")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a = " + "[" * 100_000, "nested too deeply|not TOML"),
        ("a = " + "{x=" * 100_000, "nested too deeply|not TOML"),
        ("x" * 70_000_000, "bytes, more than"),
    ],
)
def test_a_recipe_that_is_too_much(home, text, says):
    (home / "recipe.toml").write_text(text)
    with pytest.raises(ConfigurationError, match=says):
        load_recipe(home / "recipe.toml")


def test_a_pipe_as_a_recipe_does_not_hang(home):
    os.mkfifo(home / "recipe.toml")
    with pytest.raises(ConfigurationError, match="not a regular file"):
        load_recipe(home / "recipe.toml")


def test_only_what_was_named_here_is_named():
    check_named("armctl/ArmReach-v0", "a file", "--env")
    with pytest.raises(ConfigurationError, match="a file names the code colorsys:rgb_to_hsv"):
        check_named("colorsys:rgb_to_hsv", "a file", "--env")


@pytest.mark.slow
def test_workers_import_nothing_from_where_they_run(tmp_path):
    for name in ("numpy", "queue", "cloudpickle", "threadpoolctl", "orjson"):
        (tmp_path / f"{name}.py").write_text(EVIL)
    program("compare", "random", "--episodes", "2", "--workers", "2", "--out", "out", cwd=tmp_path)
    assert marks(tmp_path) == []


def test_tables_are_written_and_never_read():
    """139 kB of Parquet took 43 s to read: what lies beside a store is output. `judge` reads what its user names."""
    readers = re.compile(r"read_(parquet|table|feather|orc|hdf|pickle)|Parquet(File|Dataset)|scan_parquet|iter_batches")
    package = Path(armctl_package.__file__).parent
    judged = package / "judging" / "formats" / "parquet.py"
    assert [path for path in package.rglob("*.py") if readers.search(path.read_text())] == [judged]

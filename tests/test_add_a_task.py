"""The task of `docs/add_a_task.md`, which is nobody's but its author's, in every verb."""

import ast
import csv
import importlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import armctl
from armctl.core.errors import ConfigurationError
from armctl.envs import TaskVectorEnv, make_worlds
from armctl.shaping import Shaped
from armctl.tasks import Outcome, Task

from .command_line import armctl as in_process
from .command_line import program

EXAMPLE = Path(__file__).parents[1] / "docs" / "examples" / "hover.py"
ENV = "hover:mine/Hover-v0"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("hover")
    shutil.copy(EXAMPLE, folder)
    return folder


@pytest.fixture
def hover(monkeypatch):
    """The example's module; no later test finds its task."""
    monkeypatch.syspath_prepend(str(EXAMPLE.parent))
    registered = set(gymnasium.registry)
    yield importlib.import_module("hover")
    sys.modules.pop("hover", None)
    for name in set(gymnasium.registry) - registered:
        del gymnasium.registry[name]


@pytest.fixture
def run(folder, hover):
    return lambda *arguments: in_process(*arguments, "--env", ENV, cwd=folder).stdout


def test_the_example_is_short_and_outside_the_package():
    statements = [node for node in ast.walk(ast.parse(EXAMPLE.read_text())) if isinstance(node, ast.stmt)]
    assert len(statements) < 100


@pytest.mark.slow
def test_compare_goes_on_and_reports(folder, run):
    once = ["compare", "hover:Expert", "random", "--out", "results"]
    assert "hover:Expert is better than random" in run(*once, "--episodes", "10")
    assert "20 episodes were finished by an earlier run" in run(*once, "--episodes", "11", "--report")
    rows = list(csv.DictReader((folder / "results" / "episodes.csv").open()))
    assert len(rows) == 22
    assert {row["env"] for row in rows} == {"mine/Hover-v0"}
    assert {row["outcome"] for row in rows if row["policy"] == "hover:Expert"} == {"hovering"}
    page = (folder / "results" / "report.html").read_text()
    assert "video/mp4" in page
    assert "hovering" in page
    in_process("report", "results", cwd=folder)


@pytest.mark.slow
def test_the_default_line_up_is_the_tasks_own_also_in_a_program(folder):
    text = program("compare", "--episodes", "2", "--env", ENV, cwd=folder).stdout
    assert "hover:Expert" in text
    assert "random" in text


@pytest.mark.slow
def test_sweep_disturbs_it_in_its_own_ways(folder, run):
    disturbances = ["--disturbance", "payload=0.3", "--disturbance", "delay=2", "--disturbance", "pushes=1"]
    text = run("sweep", "hover:Expert", "--episodes", "2", "--out", "swept", *disturbances)
    assert "payload, kg" in text
    assert "payload-0.3" in (folder / "swept" / "episodes.csv").read_text()


@pytest.mark.slow
def test_run_shows_states_and_rewards(folder, run):
    text = run("run", "hover:Expert", "--steps", "2", "--video", "hover.mp4")
    assert "crash 0" in text
    assert (folder / "hover.mp4").stat().st_size > 1000


def test_collect_writes_a_dataset_and_bc_learns_from_it(folder, run):
    run("collect", "hover:Expert", "--episodes", "3", "--out", "hover-v0")
    metadata = json.loads((folder / "hover-v0" / "data" / "metadata.json").read_text())
    assert metadata["env"] == ENV


@pytest.mark.slow
def test_train_learns_with_its_own_potential(folder, run):
    options = {"worlds": 8, "batch_size": 64, "validation_episodes": 2, "evaluation_episodes": 4}
    recipe = f'learner = "ppo"\nenv = "{ENV}"\nshaping = "time"\n[options]\n'
    (folder / "mine.toml").write_text(recipe + "".join(f"{name} = {value}\n" for name, value in options.items()))
    assert "held-out episodes" in run("train", "mine.toml", "--steps", "600")
    agent = "runs/mine-0/agent.json"
    assert json.loads((folder / agent).read_text())["shaping"] == "time"
    assert "agent" in run("compare", agent, "random", "--episodes", "2")
    run("train", "mine.toml", "--steps", "900", "--resume")
    in_process("reproduce", agent, cwd=folder)


def test_a_viewer_plays_it(hover):
    from armctl.viewer.stage import Stage

    stage = Stage("hover:Expert", ENV)
    assert 0.4 < stage.status.distance < 2.5
    while stage.status.outcome is None:
        stage.step()
    assert stage.status.outcome == "hovering"


def test_gymnasium_is_content_with_it(hover):
    check_env(gymnasium.make("mine/Hover-v0").unwrapped, skip_render_check=True)


def test_the_expert_hovers_and_its_potential_telescopes(hover):
    worlds = make_worlds(ENV, 20)
    shaped = Shaped(worlds, "time", gamma=1.0)
    observations, _ = shaped.reset(seed=[3] * 20, options={"episode": np.arange(20)})
    start, total, policy = -worlds.task.goal_distances(), np.zeros(20), hover.Expert(worlds)
    finished = np.zeros(20, dtype=bool)
    while not finished.all():
        observations, _, terminated, truncated, infos = shaped.step(policy.act(observations))
        total += infos["reward_terms"]["shaping"]
        ended = terminated | truncated
        assert (infos["outcome_id"] >= 0).tolist() == ended.tolist()
        finished |= ended
    np.testing.assert_allclose(total, -start, atol=1e-9)  # a terminal state has potential 0


@pytest.mark.parametrize("method", ["reset", "command", "observe", "reward_terms", "outcome"])
def test_a_task_that_lacks_a_method_fails_when_it_is_made(method, hover):
    incomplete = type("Incomplete", (hover.HoverTask,), {method: getattr(Task, method)})
    with pytest.raises(ConfigurationError, match=f"the task Incomplete lacks {method}"):
        TaskVectorEnv(1, task=incomplete)


def test_a_task_that_lacks_outcomes_fails_when_it_is_made():
    members = ("reset", "command", "observe", "reward_terms", "outcome")
    incomplete = type("Incomplete", (Task,), dict.fromkeys(members, lambda self: None))
    with pytest.raises(ConfigurationError, match="the task Incomplete lacks outcomes"):
        TaskVectorEnv(1, task=incomplete)


def test_outcomes_are_numbered_from_timeout_on():
    class Backwards(Outcome):
        DONE = 0, True
        TIMEOUT = 1

    with pytest.raises(ConfigurationError, match="outcomes of Odd must be TIMEOUT = 0"):
        type("Odd", (Task,), {"outcomes": Backwards})


def test_what_is_no_task_is_said_to_be_none():
    armctl.register("mine/NoTask-v0", "json:JSONDecoder", max_episode_steps=5)
    with pytest.raises(ConfigurationError, match=r"a task is a subclass of armctl\.Task"):
        make_worlds("mine/NoTask-v0", 1)
    armctl.register("mine/Missing-v0", "json:Nothing", max_episode_steps=5)
    with pytest.raises(ConfigurationError, match="there is no task in json: 'Nothing'"):
        make_worlds("mine/Missing-v0", 1)
    assert "mine/Missing-v0 cannot be loaded" in " ".join(in_process("list", cwd=".").stdout.split())
    for name in ("mine/NoTask-v0", "mine/Missing-v0"):
        del gymnasium.registry[name]


@pytest.mark.slow
def test_installed_tasks_are_registered_and_broken_ones_left_out(tmp_path):
    (tmp_path / "whole.py").write_text(EXAMPLE.read_text().replace("mine/Hover", "theirs/Hover"))
    (tmp_path / "broken.py").write_text("import nothing_of_that_name\n")
    home = tmp_path / "theirs-1.0.dist-info"
    home.mkdir()
    (home / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (home / "entry_points.txt").write_text("[armctl.tasks]\nbroken = broken\nwhole = whole\n")
    code = "import armctl, gymnasium; print(gymnasium.make('theirs/Hover-v0').reset(seed=0)[0].shape)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path)
    assert done.stdout == "(18,)\n", done.stderr
    assert "the tasks of broken were left out: ModuleNotFoundError" in done.stderr


PUCK = """
import gymnasium
import mujoco
import numpy as np

import armctl
from armctl.simulation import Simulation
from armctl.tasks import Outcome, Task

PUCK = '<body name="puck"> <joint type="slide" axis="1 0 0"/> <geom size="0.1"/> </body>'
WORLD = f"<mujoco> <worldbody> {PUCK} </worldbody> </mujoco>"


class PuckOutcome(Outcome):
    TIMEOUT = 0


class Puck(Task):
    outcomes = PuckOutcome

    def __init__(self, n, options, threads=0):
        super().__init__(Simulation(mujoco.MjModel.from_xml_string(WORLD), n, threads), 0.02)
        self.qpos = self.simulation.array("qpos")
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (1,), dtype=np.float32)
        self.action_space = gymnasium.spaces.Box(-1, 1, (1,), dtype=np.float32)

    def reset(self, ids, rngs):
        self.simulation.reset(ids)
        self.qpos[ids] = [rng.uniform(-1, 1, 1) for rng in rngs]
        self.simulation.refresh(ids)

    def command(self, actions):
        pass

    def observe(self, ids=None):
        return self.qpos.astype(np.float32) if ids is None else self.qpos[ids].astype(np.float32)

    def reward_terms(self):
        return {"near": -np.abs(self.qpos[:, 0])}

    def outcome(self):
        return np.zeros(self.n, dtype=np.int8)


class Oops(Puck):
    def reward_terms(self):
        raise RuntimeError("oops")


class Crooked(Puck):
    def __init__(self, n, options, threads=0):
        raise RuntimeError("no world")


for task in (Puck, Oops, Crooked):
    armctl.register(f"puck/{task.__name__}-v0", task, max_episode_steps=5)
"""


def test_a_world_needs_no_keyframe_and_a_task_that_fails_is_one_line(tmp_path):
    (tmp_path / "puck_tasks.py").write_text(PUCK)
    compare = ["compare", "random", "--episodes", "2", "--out", "r", "--overwrite", "--env"]
    done = in_process(*compare, "puck_tasks.py:Puck-v0", cwd=tmp_path)
    assert "2 timeout" in done.stdout
    for name, said in (("Oops", "RuntimeError: oops (puck_tasks.py:"), ("Crooked", "no world (puck_tasks.py:")):
        failed = in_process(*compare, f"puck_tasks.py:{name}-v0", cwd=tmp_path, check=False)
        assert failed.returncode in (1, 2)
        assert said in " ".join((failed.stdout + failed.stderr).split())
        assert "Traceback" not in failed.stdout + failed.stderr

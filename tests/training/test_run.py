"""Trainings with several seeds, in processes of this machine and in a cluster's worker."""

import signal
import threading
import time

import pytest

from armctl.agents import read_card
from armctl.core.errors import ConfigurationError
from armctl.runtime.engines import Cluster, Local
from armctl.runtime.workers import run_isolated
from armctl.simulation.threads import THREADS_ENV_VAR
from armctl.training.learners import Recipe, load_learner
from armctl.training.run import TrainingJob, log_trial, train_seeds
from armctl.training.trials import read_trials
from tests.command_line import armctl

SMALL = {
    "demonstrations": 4, "steps": 40, "worlds": 4, "evaluation_every": 20, "validation_episodes": 3,
    "evaluation_episodes": 3, "hidden_units": 16,
}  # fmt: skip
RECIPE = Recipe(name="small", learner="bc", env="armctl/ArmReach-v0", teacher="reach_ik", options=SMALL)
TOML = """learner = "bc"
env = "armctl/ArmReach-v0"
teacher = "reach_ik"
seeds = [4, 5]
[options]
""" + "\n".join(f"{name} = {value}" for name, value in SMALL.items())


class InAChild(Cluster):
    """A cluster with one worker, which is beside this process, and works as those of Ray and Dask do."""

    workers = 1

    def count(self):
        return 1

    def _send(self, item):
        return item

    def _submit(self, common, unit):
        return run_isolated(*common, unit)  # type: ignore[call-arg]

    def _wait(self, running):
        return running, []

    def _get(self, finished):
        return finished

    def _cancel(self, running):
        pass


@pytest.fixture(scope="module")
def trained(tmp_path_factory, sized):
    """Folders and outcomes of two seeds: with `--all`, each was trained in a process of its own."""
    home = tmp_path_factory.mktemp("home") / "runs"
    folders = {seed: home / f"small-{seed}" for seed in (0, 1)}
    return folders, list(train_seeds(TrainingJob(RECIPE), folders, Local(sized(1, 2))))


@pytest.mark.slow
def test_each_seed_has_its_agent_and_a_row(trained):
    folders, ended = trained
    assert {one.seed for one in ended} == {0, 1}
    for one in ended:
        assert one.failure is None
        assert one.card == read_card(folders[one.seed] / "agent.json")
        assert one.card.training_seed == one.seed
    rows = read_trials(folders[0].parent / "trials.csv")
    assert {row["seed"] for row in rows} == {"0", "1"}
    assert {row["ended"] for row in rows} == {"finished"}


@pytest.mark.slow
def test_it_is_the_training_of_that_seed_alone(trained, tmp_path, monkeypatch):
    monkeypatch.setenv(THREADS_ENV_VAR, "1")
    alone = load_learner("bc")(RECIPE, out=tmp_path / "small-1", seed=1, progress=False)
    assert alone.sha256 == next(one.card.sha256 for one in trained[1] if one.seed == 1)


@pytest.mark.slow
def test_a_clusters_worker_sends_the_same_agent_back(trained, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "runs" / "small-1"
    (ended,) = train_seeds(TrainingJob(RECIPE), {1: folder}, InAChild())
    assert ended.failure is None, ended.failure
    assert ended.card.sha256 == next(one.card.sha256 for one in trained[1] if one.seed == 1)
    assert read_card(folder / "agent.json") == ended.card
    assert (folder / "curve.csv").exists()
    assert [row["ended"] for row in read_trials(tmp_path / "runs" / "trials.csv")] == ["finished"]
    with pytest.raises(ConfigurationError, match="holds a training already"):
        list(train_seeds(TrainingJob(RECIPE), {1: folder}, InAChild()))


@pytest.mark.slow
def test_a_resumed_job_leaves_out_what_has_finished(trained):
    folders, first = trained
    before = (folders[0].parent / "trials.csv").read_text()
    again = list(train_seeds(TrainingJob(RECIPE, resume=True), folders, Local(2)))
    assert {one.card.sha256 for one in again} == {one.card.sha256 for one in first}
    assert (folders[0].parent / "trials.csv").read_text() == before
    other = RECIPE.changed(options=SMALL | {"hidden_units": 8})
    (kept,) = train_seeds(TrainingJob(other, resume=True), {0: folders[0]}, Local(1))
    assert kept.card.sha256 == first[[one.seed for one in first].index(0)].card.sha256


@pytest.mark.slow
def test_one_that_fails_does_not_end_the_others(tmp_path):
    (tmp_path / "small-1").write_text("not a folder")
    ended = {
        one.seed: one
        for one in train_seeds(TrainingJob(RECIPE), {s: tmp_path / f"small-{s}" for s in (0, 1)}, Local(1))
    }
    assert ended[0].failure is None
    assert "small-1 is not a folder" in ended[1].failure


def end_in_all_ways(job, folder):
    for error in (KeyboardInterrupt(), RuntimeError("it diverged"), ConfigurationError("refused")):
        with pytest.raises(type(error), match=f"^{error}$"), log_trial(job, 0, folder):
            raise error


def test_how_a_training_ends_is_recorded(tmp_path):
    folder = tmp_path / "small-0"
    folder.mkdir()
    job = TrainingJob(RECIPE, {"options": {"steps": 40}})
    end_in_all_ways(job, folder)
    assert not (tmp_path / "trials.csv").exists()  # nothing had begun
    (folder / "settings.json").write_text("{}")
    end_in_all_ways(job, folder)
    rows = read_trials(tmp_path / "trials.csv")
    assert [(row["ended"], row["note"]) for row in rows] == [("interrupted", ""), ("failed", "it diverged")]


@pytest.mark.slow
def test_ctrl_c_keeps_what_has_begun(tmp_path):
    slow = RECIPE.changed(options=SMALL | {"steps": 10_000_000})
    folders = {seed: tmp_path / f"small-{seed}" for seed in (0, 1)}

    def interrupt():
        while not all((folder / "curve.csv").exists() for folder in folders.values()):
            time.sleep(0.05)
        signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        list(train_seeds(TrainingJob(slow), folders, Local(2)))
    rows = read_trials(tmp_path / "trials.csv")
    assert sorted((row["seed"], row["ended"]) for row in rows) == [("0", "interrupted"), ("1", "interrupted")]


@pytest.mark.slow
def test_the_verb_takes_several_seeds(tmp_path):
    (tmp_path / "small.toml").write_text(TOML)
    done = armctl("train", "small.toml", "--seed", "all", "--workers", "1", cwd=tmp_path)
    assert "Seed 4: Trained for" in done.stdout
    assert '"runs/small[*]"' in done.stdout.replace("'", '"')
    assert armctl("compare", "reach_ik", "runs/small[*]", "--episodes", "2", cwd=tmp_path).returncode == 0


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seed", "0,x"], "--seed takes whole numbers"),
        (["--seed", "-1"], "--seed takes whole numbers"),
        (["--seed", "0,0"], "names a seed twice"),
        (
            ["--seed", "0,1", "--track", "tensorboard"],
            "a tracker follows one training in this process: leave out --track",
        ),
        (["--seed", "99999999999"], "a training seed is a whole number from 0 to"),
        (["--on", "ry"], "Did you mean 'ray'"),
    ],
)
def test_what_cannot_be_trained_is_told(tmp_path, arguments, message):
    (tmp_path / "small.toml").write_text(TOML)
    done = armctl("train", "small.toml", *arguments, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert message in " ".join(done.stderr.split())

"""Comparisons on clusters that are really there: of Ray with two nodes, and of Dask with two workers."""

import contextlib
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from importlib import resources
from pathlib import Path
from typing import Any

import filelock
import pytest

from armctl.core.errors import ConfigurationError
from armctl.core.search_space import Range
from armctl.datasets.collect import collect
from armctl.runtime import engines
from armctl.runtime.engines import Dask, Local, Ray, connect
from armctl.simulation.threads import THREADS_ENV_VAR
from armctl.study import compare, sweep
from armctl.training.learners import load_learner
from armctl.training.run import TrainingJob, train_seeds
from armctl.tuning import candidate_of, tune
from armctl.tuning.candidates import RecipeCandidate
from armctl.tuning.trials import measure

from ..stores import timeless
from ..training.test_run import RECIPE
from .servers import servers

pytestmark = pytest.mark.slow
BIN = Path(sys.executable).parent
OPTIONS = {"max_episode_steps": 30}
ATTEMPTS = 5
"""Starts of a node of Ray, which ends unless it is there in 30 s (`ray._private.node`): on a busy machine, often."""
MINE = """
import armctl
from helpers_of_mine import still

@armctl.sees("observation")
def holding(observation):
    return still(observation)
"""


@pytest.fixture(autouse=True)
def mine(tmp_path, monkeypatch):
    """A working directory with a policy in a file, which imports another."""
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "helpers_of_mine.py").write_text("def still(observation):\n    return observation[3:9]\n")
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def processes(tmp_path_factory):
    with servers(tmp_path_factory.mktemp("servers")) as started:
        yield started


def free_port():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def until(ready, what, seconds=600, process=None):
    """Wait for a server, or for its process to end: on a busy machine the imports of Ray's head alone take minutes."""
    deadline = time.monotonic() + seconds
    while not ready():
        if time.monotonic() >= deadline:
            raise TimeoutError(f"{what} did not answer in {seconds} s")
        if process is not None and process.poll() is not None:
            raise TimeoutError(f"{what} ended")
        time.sleep(0.2)


def answers(port):
    with socket.socket() as one:
        return one.connect_ex(("127.0.0.1", port)) == 0


@pytest.fixture
def ray_head(tmp_path_factory):
    """The port of a node of Ray with a core, to which others can come, and the address for clients.

    One head at a time, of all pytest's workers: two on one machine give their clients the same ports (from 23000). It
    ends with its test: a worker that waits for more tests would keep it, and others would wait for that worker. A
    head that ends (Ray gives a node 30 s to start), or does not answer, is replaced.
    """
    with filelock.FileLock(tmp_path_factory.getbasetemp().parent / "ray.lock"), pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_AUTH_MODE", "disabled")  # Ray asks nobody for a token
        for attempt in reversed(range(ATTEMPTS)):
            with servers(tmp_path_factory.mktemp("head")) as started, short_folder() as folder:
                port, client = free_port(), 9000 + free_port() % 900
                here = ["--node-ip-address=127.0.0.1", f"--port={port}", f"--ray-client-server-port={client}"]
                head = start_ray(started, "--head", *here, "--include-dashboard=false", f"--temp-dir={folder}")
                try:
                    until(lambda client=client: answers(client), "Ray's head", 200, head)
                    until(lambda client=client: _workers(f"ray://127.0.0.1:{client}") == 1, "Ray's client", 200, head)
                except TimeoutError as error:
                    if not attempt:
                        raise RuntimeError(f"{error}: {started.output()}") from error
                    continue
                yield port, f"ray://127.0.0.1:{client}"
                return


def short_folder():
    """A folder with a path that leaves room for the names of Ray's sockets."""
    return tempfile.TemporaryDirectory(prefix="ray-", ignore_cleanup_errors=True)


@pytest.fixture
def ray_cluster(ray_head, processes):
    """The address of a cluster of two nodes, each with a core, and the second node's process.

    A second node that ends, or does not come, is replaced.
    """
    port, address = ray_head
    with connect(address) as engine:  # once: for each client, Ray starts an interpreter
        for _ in range(ATTEMPTS):
            node = start_ray(processes, f"--address=127.0.0.1:{port}")
            with contextlib.suppress(TimeoutError):
                until(lambda: engine.count() == 2, "Ray's second node", 200, node)  # type: ignore[attr-defined]
                return address, node
            processes.kill(node)
    raise RuntimeError(f"Ray's second node did not answer: {processes.output()}")


def start_ray(processes, *options):
    common = ["--num-cpus=1", "--block", "--disable-usage-stats"]
    quiet = {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "disabled"}
    patient = dict.fromkeys(("RAY_CLIENT_SERVER_CHECK_CHANNEL_TIMEOUT_S", "TIMEOUT_FOR_SPECIFIC_SERVER_S"), "200")
    return processes.start(BIN / "ray", "start", *options, *common, environment=quiet | patient)


def _workers(address):
    with contextlib.suppress(ConfigurationError), connect(address) as engine:
        return engine.count()  # type: ignore[attr-defined]
    return 0


@pytest.fixture
def dask_cluster(processes):
    """The address of a scheduler with two workers, and the second worker's process."""
    return start_dask(processes)


@pytest.fixture(scope="module")
def shared_dask(tmp_path_factory):
    """The address of a scheduler with two workers, for tests that kill none of them."""
    with servers(tmp_path_factory.mktemp("shared")) as started:
        yield start_dask(started)[0]


def start_dask(processes):
    port = free_port()
    processes.start(BIN / "dask", "scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard")
    until(lambda: answers(port), "Dask's scheduler")
    workers = [dask_worker(processes, port) for _ in range(2)]
    address = f"dask://127.0.0.1:{port}"
    until(lambda: _workers(address) == 2, "Dask's workers")
    return address, workers[1]


def dask_worker(processes, port, *more):
    return processes.start(
        BIN / "dask", "worker", f"tcp://127.0.0.1:{port}", "--nthreads", 1, "--no-nanny", "--no-dashboard", *more
    )


@pytest.fixture(params=["ray", "dask"])
def cluster(request):
    return request.getfixturevalue(f"{request.param}_cluster")


def test_a_cluster_plays_what_one_process_plays_also_if_a_node_is_killed(cluster, processes, tmp_path):
    address, node = cluster
    package = Path(str(resources.files("armctl.rl.agents")))
    for suffix in (".json", ".onnx"):
        shutil.copy((package / "reach_bc").with_suffix(suffix), tmp_path / f"copied{suffix}")
    policies = ["reach_ik", "mine.py:holding", str(tmp_path / "copied.json"), "reach_ppo"]
    told = []

    def killing(result):
        told.append(result)
        if len(told) == 20:
            processes.kill(node)

    compare(policies, episodes=40, out=tmp_path / "one", env_options=OPTIONS)
    with connect(address) as engine:
        compared = compare(
            policies, episodes=40, out=tmp_path / "two", env_options=OPTIONS, workers=engine, progress=killing
        )
    assert not compared.failures
    assert len(told) == 160
    assert timeless(tmp_path / "one").equals(timeless(tmp_path / "two"))


def test_a_cluster_records_what_one_process_records_also_if_a_node_is_killed(dask_cluster, processes, tmp_path):
    address, node = dask_cluster
    given: dict[str, Any] = {"episodes": 40, "env_options": OPTIONS}
    collect("mine.py:holding", out=tmp_path / "one", **given)

    def killing(finished):
        if finished == 8:
            processes.kill(node)

    with connect(address) as engine:
        collection = collect("mine.py:holding", out=tmp_path / "two", workers=engine, progress=killing, **given)
    assert collection.episodes == 40
    one, two = (
        {file.name: file.read_bytes() for file in (tmp_path / name / "data").iterdir()} for name in ("one", "two")
    )
    del one["metadata.json"], two["metadata.json"]  # it has the dataset's name
    assert one == two


def test_a_cluster_trains_and_tunes_as_this_machine_does(shared_dask, tmp_path, monkeypatch):
    monkeypatch.setenv(THREADS_ENV_VAR, "1")
    shutil.copy(Path(str(resources.files("armctl.rl.agents"))) / "reach_bc.onnx", tmp_path / "teacher.onnx")
    shutil.copy(Path(str(resources.files("armctl.rl.agents"))) / "reach_bc.json", tmp_path / "teacher.json")
    recipe = RECIPE.changed(teacher=str(tmp_path / "teacher.json"))
    alone = load_learner("bc")(recipe, out=tmp_path / "alone" / "small-0", seed=0, progress=False)
    expert = candidate_of("reach_mpc", episodes=2)
    learner = RecipeCandidate("small", {"options.hidden_units": Range(choices=(8, 16))}, "return", recipe, (0,))
    with connect(shared_dask) as engine:
        trained = list(
            train_seeds(TrainingJob(recipe), {seed: tmp_path / "runs" / f"small-{seed}" for seed in (0, 1)}, engine)
        )
        tuned = [tune(one, tmp_path / one.name, trials=2, workers=engine) for one in (expert, learner)]
    assert [one.failure for one in trained] == [None, None]
    assert {one.seed: one.card.sha256 for one in trained}[0] == alone.sha256
    for found in tuned:
        assert len(found.finished) >= 2
        assert measure(found.candidate, 0, found.best.params, tmp_path / "again", []).value == found.best.value


def test_a_worker_with_other_versions_is_refused_by_name(dask_cluster, processes, tmp_path):
    address, node = dask_cluster
    processes.kill(node)
    (tmp_path / "older.py").write_text(
        "from armctl.runtime import workers\n"
        "versions = workers.versions()\n"
        "workers.versions = lambda: versions | {'numpy': '1.0'}\n"
    )
    port = address.rpartition(":")[2]
    dask_worker(processes, port, "--preload", tmp_path / "older.py")
    until(lambda: _workers(address) == 2, "Dask's other worker")
    with connect(address) as engine:
        compared = compare(["random"], episodes=40, out=tmp_path / "out", env_options=OPTIONS, workers=engine)
    assert f"the worker on {socket.gethostname()} differs" in compared.failures["workers"]
    assert "versions: numpy 1.0 there" in compared.failures["workers"]
    kept = timeless(tmp_path / "out")
    compare(["random"], episodes=40, out=tmp_path / "alone", env_options=OPTIONS)
    alone = timeless(tmp_path / "alone")
    assert kept.to_csv(index=False) == alone[alone.episode.isin(kept.episode)].to_csv(index=False)


def test_a_policy_that_ends_its_process_is_told(shared_dask, tmp_path):
    (tmp_path / "dying.py").write_text("import os\n\ndef die(observation):\n    os._exit(1)\n")
    with connect(shared_dask) as engine:
        compared = compare(["dying.py:die"], episodes=2, workers=engine)
        assert "dying.py:die: its process on" in compared.failures["workers"]
        assert not compare(["random"], episodes=2, workers=engine, env_options=OPTIONS).failures


def test_what_cannot_be_loaded_there_is_told(shared_dask, tmp_path):
    (tmp_path / "here.py").write_text(
        "from pathlib import Path\nPath('only_here').read_text()\nhold = lambda x: x[3:9]\n"
    )
    (tmp_path / "only_here").touch()
    with connect(shared_dask) as engine:
        compared = compare(["here.py:hold"], episodes=2, workers=engine)
    assert "here.py:hold cannot be done on" in compared.failures["workers"]
    assert "only_here" in compared.failures["workers"]


def test_a_lost_scheduler_is_told_and_finished_episodes_are_kept(dask_cluster, processes, tmp_path):
    told = []

    def killing(result):
        told.append(result)
        if len(told) == 5:
            processes.kill(processes.started[0])

    with contextlib.suppress(Exception), connect(dask_cluster[0]) as engine:
        compared = compare(
            ["reach_ik"], episodes=200, workers=engine, out=tmp_path / "out", progress=killing, env_options=OPTIONS
        )
        assert "the cluster was lost" in compared.failures["workers"] or "no worker" in compared.failures["workers"]
        assert len(timeless(tmp_path / "out")) == len(told) >= 5


def test_an_edited_module_is_not_played_as_it_was(shared_dask, tmp_path):
    """From two programs, as one would work: the workers stay."""
    program = (
        "import armctl\nfrom armctl.runtime.engines import connect\n"
        f"with connect({shared_dask!r}) as engine:\n"
        "    options = {'max_episode_steps': 5}\n"
        "    found = armctl.compare(['edited.py:act'], episodes=2, workers=engine, env_options=options)\n"
        "    assert not found.failures, found.failures\n"
        "    print(found.episodes.path_length.max())\n"
    )
    (tmp_path / "edited.py").write_text("from its_helper import shift\n\ndef act(x):\n    return x[3:9] + shift\n")
    lengths = []
    for shift in (0.0, 0.5):
        (tmp_path / "its_helper.py").write_text(f"shift = {shift}\n")
        run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=tmp_path)
        lengths.append(float(run.stdout))
    assert lengths[0] < 0.01 < lengths[1]


def test_a_sweep_with_a_policy_of_ones_own(shared_dask):
    with connect(shared_dask) as engine:
        swept = sweep(["mine.py:holding"], disturbances={"delay": [1]}, episodes=2, workers=engine, env_options=OPTIONS)
    assert not swept.failures
    assert set(swept.comparisons) == {"none", "delay-1.0"}


@pytest.mark.parametrize(
    ("address", "says"),
    [
        ("rey", "Did you mean 'ray'"),
        ("ray://nowhere", "there is no engine"),
        ("dask", "dask://HOST:PORT"),
        ("dask://127.0.0.1:9", "no scheduler of Dask answers"),
    ],
)
def test_what_cannot_be_reached_is_told(address, says, monkeypatch):
    monkeypatch.setattr(engines, "PATIENCE", 0.5)
    with pytest.raises(ConfigurationError, match=says):
        connect(address)


@pytest.mark.parametrize(("engine", "module"), [(Ray, "ray"), (Dask, "distributed")])
def test_a_missing_engine_is_named_with_its_extra(engine, module, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ConfigurationError, match=rf"{module}: pip install 'armctl-suite\[cluster\]'"):
        engine("somewhere:1")


def test_an_engine_of_this_machine_is_the_default():
    assert isinstance(connect("local", 3), Local)
    assert connect("local", 3).workers == 3

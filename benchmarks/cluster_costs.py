"""Costs of each part of a cluster, for `benchmarks/clusters.py`."""

import contextlib
import operator
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any
from unittest import mock

import cloudpickle
import numpy as np
import psutil
from cluster_servers import dask_cluster, ray_cluster

import armctl
from armctl.episodes.record import EpisodeResult
from armctl.episodes.store import Store
from armctl.episodes.stored import UNDISTURBED
from armctl.rollout.parallel import ROUNDS, RolloutBatch
from armctl.runtime.engines import AHEAD, Cluster, Engine, Local, connect

SHORT, LONG = "armctl/ArmReach-v0", "armctl/BridgeCross-v0"
POLICIES = {SHORT: ("reach_ik", "reach_ppo"), LONG: ("bridge_mpc", "bridge_ppo")}
UNITS, UNDER_WAY = 400, 1000
"""Units without work that are timed: as they come, and while so many are under way."""
WRITTEN = 5000
"""Episodes whose writing is timed."""


def compared(episodes: int) -> list[dict[str, Any]]:
    """Time a comparison in one process, in two, and on clusters: seconds until connected, until the first result, ...

    Servers start before the clock, as a cluster is there already.
    """
    runs = [_run("1 process", Local(1), 1, episodes), _run("`--workers 2`", Local(2), 2, episodes)]
    with ray_cluster(2) as address:
        runs.append(_run_on("Ray, 2 nodes", address, 2, episodes))
    for workers in (1, 2, 4):
        with dask_cluster(workers) as address:
            runs.append(_run_on(f"Dask, {workers} worker{'s' if workers > 1 else ''}", address, workers, episodes))
    return runs


def _run_on(where: str, address: str, workers: int, episodes: int) -> dict[str, Any]:
    start = time.perf_counter()
    with connect(address) as engine:
        return _run(where, engine, workers, episodes, time.perf_counter() - start)


def _run(where: str, engine: Engine, workers: int, episodes: int, connect_s: float = 0.0) -> dict[str, Any]:
    ends: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        start, spent = time.perf_counter(), _processor_s()
        comparison = armctl.compare(
            POLICIES[SHORT], SHORT, episodes=episodes, out=folder, workers=engine,
            progress=lambda _: ends.append(time.perf_counter()),
        )  # fmt: skip
        all_s = time.perf_counter() - start
    if comparison.failures or comparison.interrupted:
        raise SystemExit(f"{where}: the comparison did not come to its end: {comparison.failures}")
    return {
        "where": where, "workers": workers, "episodes": len(ends), "connect_s": connect_s,
        "first_s": ends[0] - start, "all_s": all_s, "processor_s": _processor_s() - spent,
    }  # fmt: skip


def durations(env: str, episodes: int) -> dict[str, list[float]]:
    """Return the seconds of each episode in one process, by policy, except the first, which makes and compiles."""
    ends: dict[str, list[float]] = {name: [] for name in POLICIES[env]}
    armctl.compare(
        POLICIES[env], env, episodes=episodes, progress=lambda result: ends[result.policy].append(time.perf_counter())
    )
    return {name: np.round(np.diff(times), 6).tolist() for name, times in ends.items()}


def writing() -> float:
    """Return the seconds that the client takes to keep and write an episode."""
    template = _a_batch(1).results[0]
    identity = {"env": template.env, "seed": template.seed, "policies": [template.policy]}
    with tempfile.TemporaryDirectory() as folder, Store(Path(folder)) as store:
        store.open(template.seed, [UNDISTURBED])
        log = store.cell(UNDISTURBED, identity, WRITTEN)
        start = time.perf_counter()
        for episode in range(WRITTEN):
            log.write(replace(template, episode=episode))
        return (time.perf_counter() - start) / WRITTEN


def sizes() -> dict[str, int]:
    """Return the bytes of a block's unit and of its result, pickled."""
    unit = (POLICIES[SHORT][0], list(range(ROUNDS)), dict.fromkeys(range(ROUNDS), 10.0), None)
    return {"unit": len(cloudpickle.dumps(unit)), "result": len(cloudpickle.dumps(_a_batch(ROUNDS)))}


def of_ray() -> dict[str, Any]:
    """Return the costs of Ray."""
    with ray_cluster(2) as address:
        return _costs(address)


def of_dask() -> dict[str, Any]:
    """Return the costs of Dask."""
    with dask_cluster(2) as address:
        return _costs(address)


def _costs(address: str) -> dict[str, Any]:
    """Return seconds by the names of `cluster_model.Costs`, from units that only return the result of a block.

    A worker's start is the time to its first unit of a real comparison, less what one process needs for that.
    """
    unit, shared = ("a block",), {"a block": _a_batch(ROUNDS)}
    with connect(address) as engine:
        assert isinstance(engine, Cluster)

        def run(units: int, workers: int, sent: list[float]) -> Iterator[Any]:
            def counted() -> Iterator[tuple[str]]:
                for _ in range(units):
                    sent.append(time.perf_counter())
                    yield unit

            engine.workers = workers
            return engine.run(operator.getitem, shared, counted())

        list(run(10, 2, []))  # starts the workers' processes
        spent_before, start = _processor_s_by_process(), time.perf_counter()
        list(run(UNITS, 1, []))
        round_trip = AHEAD * (time.perf_counter() - start) / UNITS  # by Little's law: so many are under way
        spent = {
            process: (seconds - spent_before.get(process, 0.0)) / UNITS
            for process, seconds in _processor_s_by_process().items()
        }
        sent: list[float] = []
        results = run(UNDER_WAY, UNDER_WAY // AHEAD, sent)
        next(results)
        time.sleep(1.5 * UNDER_WAY * round_trip / AHEAD)  # all are finished then
        with _fetches() as fetches:
            start = time.perf_counter()
            remaining = len(list(results))
            took = time.perf_counter() - start
    fetched = sum(fetches)
    receive, wait = fetched / remaining, (took - fetched) / remaining
    schedule = max(seconds for (kind, _), seconds in spent.items() if kind == "scheduler")
    work = sum(seconds for (kind, _), seconds in spent.items() if kind == "worker")
    send = (sent[-1] - sent[0]) / (UNDER_WAY - 1)
    spent_beside = send + schedule + work + receive + AHEAD * wait
    return {
        "send": send, "schedule": schedule, "transport": max(0.0, round_trip - spent_beside), "work": work,
        "wait": wait, "receive": receive,
    }  # fmt: skip


@contextlib.contextmanager
def _fetches() -> Iterator[list[float]]:
    """Collect the seconds of each call within the block that fetches finished results."""
    took: list[float] = []

    def timed(cluster: Cluster, finished: list[Any]) -> list[Any]:
        start = time.perf_counter()
        results = cluster._get(finished)
        took.append(time.perf_counter() - start)
        return results

    with mock.patch.object(Cluster, "_fetched", timed):
        yield took


def _a_batch(episodes: int) -> RolloutBatch:
    episodes_played: list[EpisodeResult] = []
    armctl.compare(POLICIES[SHORT][:1], SHORT, episodes=episodes, progress=episodes_played.append)
    return RolloutBatch(POLICIES[SHORT][0], episodes_played)


def _kind(command: str) -> str:
    """Return what a process does. A cluster of Ray has one scheduler, of Dask one for each client."""
    kinds = {
        "scheduler": ("dask scheduler", "gcs_server", "raylet", "ray.util.client.server"),
        "worker": ("dask worker", "ray::IDLE", "ray::run_isolated", "Loky"),
    }
    return next((kind for kind, words in kinds.items() if any(word in command for word in words)), "other")


def _processor_s_by_process() -> dict[tuple[str, int], float]:
    """Return processor seconds of each child, by what it does, and its id."""
    seconds = {}
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):  # it has ended
            seconds[_kind(" ".join(process.cmdline())), process.pid] = _spent(process)
    return seconds


def _processor_s() -> float:
    """Return processor seconds of this process and its children."""
    return _spent(psutil.Process()) + sum(_processor_s_by_process().values())


def _spent(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system + times.children_user + times.children_system)


def versions() -> dict[str, str]:
    """Return the versions of what is measured."""
    return {"armctl": armctl.__version__, "ray": version("ray"), "distributed": version("distributed")}

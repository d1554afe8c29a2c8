"""Parallel work: in processes of this machine, or on a cluster of Ray or Dask.

An engine does units of work and yields their results as they come. Units of a worker that is lost are done again by
another; each unit has one result. Ray and Dask are used directly: joblib's backend for Ray cannot yield results as they
come, and futures of Dask's executor fetch one result each, where a call for many takes hardly longer.
"""

import contextlib
import itertools
import os
import re
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any, Self, get_type_hints

from armctl.core.errors import ConfigurationError, described, missing_extra, reason, unknown_name
from armctl.runtime.sending import JobBundle
from armctl.runtime.workers import Work, WorkersFailed, end_with_parent, environment_of, run_isolated

RETRIES = 3
"""Number of times that a unit is done again whose worker was lost, or that a cluster is asked again."""
SILENCE = 30.0
"""s between two looks whether there are workers left, while none has finished anything."""
PATIENCE = 10.0
"""Time that a scheduler of Dask may take to answer, s."""
AHEAD = 2
"""Units that wait or run on a cluster at once, per worker: so that none is idle between two units."""

MIN_CLUSTER_WORKERS = 2
"""Workers that are assumed: other machines' decision times are never judged as those of this one, working alone."""


class Engine(ABC):
    """Workers, each with a core. It is a context manager, whose end lets go of the workers."""

    workers: int
    """Number of units that are worked on at once."""
    is_local = False
    """True if all work is done in this process."""
    groups_units = False
    """True if small units are sent together."""

    @abstractmethod
    def run(self, work: Work, shared: Any, units: Iterable[tuple[Any, ...]]) -> Generator[Any, None, None]:
        """Yield the results of `work(shared, *unit)` in any order. Closing the iterator discards what is not finished.

        Units are taken from their iterator as there is room. Raises `WorkersFailed`, and what `work` raises.
        """

    def close(self) -> None:  # noqa: B027  # processes of this machine serve the next call too
        """Let go of the workers."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def engine_of(workers: "int | Engine") -> Engine:
    """Return an engine; so many processes of this machine, if a number is given."""
    return workers if isinstance(workers, Engine) else Local(workers)


def connect(address: str, workers: int = 1) -> Engine:
    """Return the engine at an address: `local`, `ray`, `ray://HOST:PORT` or `dask://HOST:PORT`.

    `ray` is the cluster of which this machine is a part, or else this machine. `workers` is for `local`.

    Raises `ConfigurationError` for an address of another form, an engine that is not installed, and a cluster that does
    not answer.
    """
    if address == "local":
        return Local(workers)
    if workers > 1:
        raise ConfigurationError(f"{workers} workers are for this machine: on {address}, all of the cluster work")
    if address == "ray" or re.fullmatch(r"ray://.+:\d+", address):
        return Ray(None if address == "ray" else address)
    if re.fullmatch(r"dask://.+:\d+", address):
        return Dask(address.replace("dask://", "tcp://"))
    raise unknown_name("engine", address, ["local", "ray", "ray://HOST:PORT", "dask://HOST:PORT"])


MAX_WORKERS = 1_000
SHARE_OF_MEMORY, MIN_GROWTH = 0.25, 300 * 10**6
"""Share of this machine's memory by which all workers grow, and bytes of one at least, until loky replaces it. A new
one makes its policies and worlds anew, and those of a cell take more than loky's default, 300 MB."""


class Local(Engine):
    """Processes of this machine, through joblib (loky)."""

    groups_units = True

    def __init__(self, workers: int) -> None:
        if not 1 <= workers <= MAX_WORKERS:
            raise ConfigurationError(f"workers must be at least 1 and at most {MAX_WORKERS:,}, not {workers:,}")
        self.workers, self.is_local = workers, workers == 1

    def run(self, work: Work, shared: Any, units: Iterable[tuple[Any, ...]]) -> Generator[Any, None, None]:
        """Yield results; see `Engine`. Workers can use all that this process has imported or has in memory."""
        import joblib  # a tenth of a second, which a single process does not need

        # loky replaces workers that have grown
        warnings.filterwarnings("ignore", "A worker stopped while some jobs were given", UserWarning)
        parallel = joblib.Parallel(
            self.workers,
            backend="loky",
            return_as="generator_unordered",
            initializer=_begin_worker,
            initargs=(os.getpid(), largest_growth(self.workers)),
        )
        try:
            with contextlib.closing(parallel(joblib.delayed(work)(shared, *unit) for unit in units)) as results:
                yield from results
        except BrokenProcessPool as error:
            raise WorkersFailed(f"a worker process died, or could not load what it was sent: {error}") from error


def largest_growth(workers: int) -> int:
    """Return the bytes by which each of so many workers may grow."""
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return max(MIN_GROWTH, int(SHARE_OF_MEMORY * memory / workers))


def _begin_worker(parent: int, growth: int) -> None:
    from joblib.externals.loky import process_executor

    process_executor._MAX_MEMORY_LEAK_SIZE = growth
    end_with_parent(parent)


class Cluster(Engine):
    """Workers on other machines, to which everything is sent in a bundle."""

    def run(
        self, work: Work, shared: Any, units: Iterable[tuple[Any, ...]], files: Iterable[Path] = ()
    ) -> Generator[Any, None, None]:
        """Yield results; see `Engine`. `files` are sent along, which `shared` names by relative paths."""
        common = [self._send(item) for item in (work, JobBundle.of(shared, files), environment_of(work))]
        waiting, running = iter(units), list[Any]()
        kind = get_type_hints(work).get("return")
        try:
            while True:
                for unit in itertools.islice(waiting, AHEAD * self.workers - len(running)):
                    running.append(self._submit(common, unit))  # after Ctrl-C, all that run are known
                if not running:
                    return
                finished, running = _failing_as_lost(self._wait, running)
                for result in self._fetched(finished):
                    if isinstance(kind, type) and not isinstance(result, kind):
                        raise WorkersFailed(
                            f"a worker returned a {type(result).__name__} in place of a {kind.__name__}"
                        )
                    yield result
        finally:
            with contextlib.suppress(Exception):  # of a cluster that was lost
                self._cancel(running)

    def _fetched(self, finished: list[Any]) -> Iterator[Any]:
        """Yield results of finished units by one call, since a call takes longer than a result; one each if one failed.

        Results before a failed one are kept. Raises `WorkersFailed` for it.
        """
        try:
            yield from self._get(finished)
        except Exception:  # whatever a unit raises
            yield from (_failing_as_lost(self._get, [unit])[0] for unit in finished)

    @abstractmethod
    def count(self) -> int:
        """Return the present number of workers."""

    @abstractmethod
    def _send(self, item: Any) -> Any:
        """Send an argument that all units share, once for all."""

    @abstractmethod
    def _submit(self, common: list[Any], unit: Any) -> Any:
        """Begin `run_isolated(*common, unit)`."""

    @abstractmethod
    def _wait(self, running: list[Any]) -> tuple[list[Any], list[Any]]:
        """Return the units that have finished, as soon as one has, and those that still run."""

    @abstractmethod
    def _get(self, finished: list[Any]) -> list[Any]:
        """Return the results of units. Raises what a unit has raised."""

    @abstractmethod
    def _cancel(self, running: list[Any]) -> None:
        """Cancel units."""


class Ray(Cluster):
    """A cluster of Ray, as its client or as one of its machines."""

    def __init__(self, address: str | None = None) -> None:
        try:
            import ray
        except ModuleNotFoundError as error:
            raise missing_extra("--on ray", error, "cluster") from error
        os.environ.setdefault("RAY_IGNORE_UNHANDLED_ERRORS", "1")  # they are raised here
        self._ray, self._has_joined = ray, not ray.is_initialized()
        if address and not self._has_joined:
            raise ConfigurationError(f"this process belongs to a cluster of Ray already: `ray` is that, not {address}")
        if self._has_joined:
            _join(ray, address)
        self._task = ray.remote(num_cpus=1, max_retries=RETRIES)(run_isolated)
        self.workers = max(MIN_CLUSTER_WORKERS, self.count())

    def count(self) -> int:
        """Return the present number of processors of the cluster."""
        return int(self._ray.cluster_resources().get("CPU", 0))

    def close(self) -> None:
        """Leave the cluster, if this engine has joined it."""
        if self._has_joined:
            self._ray.shutdown()

    def _send(self, item: Any) -> Any:
        return self._ray.put(item)

    def _submit(self, common: list[Any], unit: Any) -> Any:
        return self._task.remote(*common, unit)

    def _wait(self, running: list[Any]) -> tuple[list[Any], list[Any]]:
        self._ray.wait(running)
        finished, others = self._ray.wait(running, num_returns=len(running), timeout=0)
        return finished, others

    def _get(self, finished: list[Any]) -> list[Any]:
        return list(self._ray.get(finished))

    def _cancel(self, running: list[Any]) -> None:
        for unit in running:
            self._ray.cancel(unit)


class Dask(Cluster):
    """A cluster of Dask."""

    def __init__(self, address: str) -> None:
        try:
            import distributed
        except ModuleNotFoundError as error:
            raise missing_extra("--on dask", error, "cluster") from error
        self._dask = distributed
        try:
            self._client = distributed.Client(address, timeout=PATIENCE, set_as_default=False)
        except OSError as error:
            raise ConfigurationError(f"no scheduler of Dask answers at {address}: {reason(error)}") from error
        self.workers = max(MIN_CLUSTER_WORKERS, self.count())

    def count(self) -> int:
        """Return the present number of the cluster's worker processes."""
        return len(self._client.scheduler_info(n_workers=-1)["workers"])

    def close(self) -> None:
        """Leave the cluster."""
        self._client.close()

    def _send(self, item: Any) -> Any:  # as a task, which the scheduler keeps: workers that die lose scattered data
        return self._client.submit(_itself, item, pure=False)

    def _submit(self, common: list[Any], unit: Any) -> Any:
        return self._client.submit(run_isolated, *common, unit, pure=False)

    def _wait(self, running: list[Any]) -> tuple[list[Any], list[Any]]:
        while True:
            try:
                with self._client.as_current():
                    finished, others = self._dask.wait(running, SILENCE, "FIRST_COMPLETED")
                return list(finished), list(others)
            except TimeoutError:
                if not self.count():
                    raise WorkersFailed(
                        "no worker of the cluster is left: they died, or have no armctl like this one"
                    ) from None

    def _get(self, finished: list[Any]) -> list[Any]:
        return list(self._client.gather(finished))

    def _cancel(self, running: list[Any]) -> None:
        self._client.cancel(running)


def _join(ray: Any, address: str | None) -> None:
    """Join a cluster of Ray. Its head starts a process for each client; where that fails, it is asked again."""
    for attempt in itertools.count(1):
        try:
            ray.init(address, log_to_driver=False, logging_level="ERROR", include_dashboard=False)
            return
        except (ConnectionError, ValueError, RuntimeError) as error:
            if attempt <= RETRIES and "Starting Ray client server failed" in str(error):
                continue
            raise ConfigurationError(
                f"no cluster of Ray answers at {address}: {error}. If it asks for a token, set RAY_AUTH_MODE=token"
            ) from error


def _failing_as_lost(call: Callable[[list[Any]], Any], units: list[Any]) -> Any:
    """Return `call(units)`. Raises `WorkersFailed` for whatever becomes of units, or of a cluster that was lost."""
    try:
        return call(units)
    except Exception as error:
        cause = getattr(error, "cause", None)  # of Ray, what a unit raised
        if isinstance(failure := cause or error, WorkersFailed):
            raise failure from None
        lost = f"workers died again and again, or the cluster was lost: {error}"
        raise WorkersFailed(described(cause) if isinstance(cause, BaseException) else lost) from error


def _itself(value: Any) -> Any:
    return value

"""A simulated cluster, by discrete events: a client that also writes, a scheduler, and workers that may be lost.

The client is the loop of `armctl.runtime.engines`: it sends units until `AHEAD` per worker are under way, waits
until one is finished, and writes the episodes of what is, one after the other. Units wait in one queue for whoever is
free.
"""

import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import simpy

from armctl.runtime.engines import AHEAD

DETECTION = 30.0
"""s until the cluster knows that a worker is lost, and gives its unit to another."""

Process = Generator[simpy.Event, Any, None]


@dataclass(frozen=True)
class Costs:
    """Seconds that work takes besides the episodes. Where no unit is named, each unit costs as much."""

    start: float = 0.0
    """Seconds until a worker can begin with its first unit."""
    send: float = 0.0
    """The client's."""
    schedule: float = 0.0
    """The scheduler's: it does one unit after the other."""
    transport: float = 0.0
    """There and back, beside everything else."""
    work: float = 0.0
    """The worker's."""
    wait: float = 0.0
    """The client's for each call that waits and gives all that is finished, per unit under way."""
    receive: float = 0.0
    """The client's."""
    write: float = 0.0
    """The client's per episode."""

    def limit(self, episodes: int) -> float:
        """Return the units of so many episodes per second that client and scheduler can do; each call gives all."""
        client = self.send + self.wait + self.receive + self.write * episodes
        return 1 / max(client, self.schedule, 1e-12)

    def saturated_by(self, seconds: float, episodes: int) -> int:
        """Return the fewest workers that do units of so many seconds and episodes as fast as that limit."""
        return max(1, math.ceil((seconds + self.work) * self.limit(episodes)))


@dataclass
class Outcome:
    """Result of a simulation."""

    seconds: float = 0.0
    """Seconds until the last result was written."""
    results: list[int] = field(default_factory=list)
    """Units, in the order in which their results were written."""
    again: int = 0
    """Units whose worker was lost with them."""
    wasted: float = 0.0
    """Worker seconds that were spent on these."""
    lost: int = 0
    """Workers."""
    client_busy: float = 0.0
    """s"""


def simulated(
    durations: Sequence[float],
    episodes: int,
    workers: int,
    costs: Costs,
    losses: float = 0.0,
    rng: np.random.Generator | None = None,
) -> Outcome:
    """Simulate a comparison of units that take so long (s) in a worker, of so many `episodes` each.

    Workers are lost at the rate `losses` (1/s each), and not replaced. If none is left, results are missing.
    """
    return _Cluster(durations, episodes, workers, costs, losses, rng or np.random.default_rng(0)).outcome


class _Cluster:
    def __init__(
        self,
        durations: Sequence[float],
        episodes: int,
        workers: int,
        costs: Costs,
        losses: float,
        rng: np.random.Generator,
    ) -> None:
        self._durations, self._episodes, self._workers, self._costs = durations, episodes, workers, costs
        self._env, self.outcome = simpy.Environment(), Outcome()
        self._scheduler = simpy.Resource(self._env)
        self._queue, self._finished = simpy.Store(self._env), simpy.Store(self._env)
        self._env.process(self._client())
        for _ in range(workers):
            self._env.process(self._worker(rng.exponential(1 / losses) if losses else math.inf))
        self._env.run()

    def _client(self) -> Process:
        costs, under_way, waiting = self._costs, 0, iter(range(len(self._durations)))
        while True:
            for unit in _some(waiting, AHEAD * self._workers - under_way):
                yield self._busy(costs.send)
                self._env.process(self._sent(unit))
                under_way += 1
            if not under_way:
                return
            done = [(yield self._finished.get()), *self._finished.items]
            self._finished.items.clear()
            yield self._busy(costs.wait * under_way)
            for unit in done:
                yield self._busy(costs.receive + costs.write * self._episodes)
                self.outcome.results.append(unit)
                self.outcome.seconds = self._env.now
            under_way -= len(done)

    def _busy(self, seconds: float) -> simpy.Event:
        self.outcome.client_busy += seconds
        return self._env.timeout(seconds)

    def _sent(self, unit: int) -> Process:
        with self._scheduler.request() as turn:
            yield turn
            yield self._env.timeout(self._costs.schedule)
        yield self._env.timeout(self._costs.transport / 2)
        self._queue.put(unit)

    def _worker(self, death: float) -> Process:
        """Simulate a worker that is lost at a time. Idle, it is found dead only by the unit that would be its next."""
        yield self._env.timeout(self._costs.start)
        while True:
            unit = yield self._queue.get()
            takes = self._costs.work + self._durations[unit]
            if (lives := death - self._env.now) < takes:
                self.outcome.lost += 1
                if lives > 0:
                    self.outcome.again += 1
                    self.outcome.wasted += lives
                    yield self._env.timeout(lives + DETECTION)
                self._queue.put(unit)
                return
            yield self._env.timeout(takes)
            self._env.process(self._returned(unit))

    def _returned(self, unit: int) -> Process:
        yield self._env.timeout(self._costs.transport / 2)
        self._finished.put(unit)


def _some(units: Iterator[int], count: int) -> Iterator[int]:
    return (unit for _, unit in zip(range(count), units, strict=False))

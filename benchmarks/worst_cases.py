"""The search of the mildest failure, on policies whose success is known.

    python benchmarks/worst_cases.py [--runs 10] [--budget 300]
    python benchmarks/worst_cases.py --cma-es        # also CMA-ES with the same budget; needs the package cmaes

A policy is its logarithmic odds of success in the unit box. CMA-ES plays 20 episodes at each point, and minimises the
distance of points with at most half of these won; of the others, success.

The interval of a search's distance is counted as right where it has the distance at which success truly falls to one
half on its line; "above" counts searches whose upper limit is at least the distance of the mildest failure anywhere.
"""

import importlib
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import numpy as np
import scipy
import typer
from numpy.typing import NDArray
from printing import progress, show, versioned_table

from armctl.core.arrays import Array
from armctl.stats.failure_line import SCALES, failure_distance, line_through
from armctl.stats.failure_surface import fitted_surface, round_box, round_sizes

JUDGING = 100
"""Episodes at each point of a line."""
BLOCK = 20
"""Episodes of CMA-ES at each point."""
WEIGHTS = np.array([1.0, 0.6, 0.3, 0.2, 0.1])
Odds = Callable[[Array], Array]
Point = Array | None


def policies(dimension: int) -> dict[str, Odds]:
    """Return the logarithmic odds of success of policies under so many disturbances."""
    weights = WEIGHTS[:dimension]
    ends = np.array([0.5, 0.7, 0.9, 0.9, 0.9])[:dimension]
    return {
        "sum": lambda x: 4 - 12.8 * (x @ weights) / weights.sum(),
        "steep in one": lambda x: 30 * (0.4 - x[:, 0]) - 2 * x[:, 1],
        "ball": lambda x: 5 - 14 * (x**2).sum(axis=1),
        "only together": lambda x: 4 - 20 * x[:, 0] * x[:, 1],
        "the worst of all": lambda x: 12 * (ends - x).min(axis=1),
        "from a level on": lambda x: 3 - 24 * np.clip(x[:, 0] - 0.3, 0, None) - 12 * x[:, 1] ** 4,
        "80 % undisturbed": lambda x: 1.386 - 4 * (x @ weights),
        "early": lambda x: 3 - 30 * (x[:, 0] + 0.5 * x[:, 1]),
    }


def sampled_success(odds: Odds, points: Array, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Play an episode at each point."""
    return np.asarray(rng.random(len(points)) < scipy.special.expit(odds(points)))


def surface_search(odds: Odds, dimension: int, budget: int, rng: np.random.Generator) -> Point:
    """Search as `armctl worst-case` does."""
    point, center = None, np.full(dimension, 0.5)
    points, success = np.empty((0, dimension)), np.empty(0, dtype=bool)
    for number, count in enumerate(round_sizes(budget)):
        new = rng.uniform(*round_box(center, number), (count, dimension))
        points, success = np.vstack([points, new]), np.concatenate([success, sampled_success(odds, new, rng)])
        point = fitted_surface(points, success).mildest({})
        center = np.ones(dimension) if point is None else point
    return point


def judged(odds: Odds, points: Sequence[Point], dimension: int, nearest: float) -> tuple[str, str]:
    """Return how many intervals have the truth on their line, and how many reach the nearest failure anywhere."""
    rng, right, above = np.random.default_rng(8), 0, 0
    for point in points:
        line = line_through(np.ones(dimension) if point is None else point)
        distances = np.linalg.norm(line, axis=1)
        won = rng.binomial(JUDGING, scipy.special.expit(odds(line)))
        distance = failure_distance(distances, won, [JUDGING] * len(line))
        low, high = distance.bounds
        path = (np.linspace(0, SCALES[-1] / SCALES[0], 5000)[:, None] * line[0]).clip(max=1.0)
        fails = (odds(path) <= 0) & (path <= line[-1]).all(axis=1)
        truth = float(np.linalg.norm(path[fails.argmax()])) if fails.any() else np.inf
        right += low <= truth <= high
        above += high >= nearest
    return f"{right} of {len(points)}", f"{above} of {len(points)}"


def cma_search(odds: Odds, dimension: int, budget: int, rng: np.random.Generator) -> Point:
    """Search by CMA-ES (Hansen and Ostermeier 2001), by the package cmaes."""
    cma: Any = importlib.import_module("cmaes")
    optimiser = cma.CMA(
        np.full(dimension, 0.5), 0.3, bounds=np.array([[0.0, 1.0]] * dimension), seed=int(rng.integers(2**31))
    )
    best: tuple[float, Point] = (np.inf, None)
    for _ in range(budget // (BLOCK * optimiser.population_size)):
        solutions = []
        for _ in range(optimiser.population_size):
            point = optimiser.ask()
            rate = sampled_success(odds, np.repeat(point[None], BLOCK, axis=0), rng).mean()
            value = float(np.linalg.norm(point)) if rate <= 0.5 else dimension + rate
            best = min(best, (value, point), key=lambda item: item[0])
            solutions.append((point, value))
        optimiser.tell(solutions)
    return best[1] if best[0] < dimension else None


def true_distance(odds: Odds, dimension: int) -> float:
    """Return the distance of the mildest point with success in half of the episodes, on many rays."""
    rays = np.abs(np.random.default_rng(1).standard_normal((20_000, dimension)))
    rays = np.vstack([np.eye(dimension), rays])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    for distance in np.arange(0, np.sqrt(dimension), 0.005):
        points = distance * rays
        if (odds(points[(points <= 1).all(axis=1)]) <= 0).any():
            return float(distance)
    return np.inf


def described(odds: Odds, points: Sequence[Point]) -> tuple[str, str]:
    """Return the mean distance, and the range of true success, of what searches have returned."""
    results = [point for point in points if point is not None]
    if not results:
        return "-", "-"
    success = 100 * scipy.special.expit(odds(np.array(results)))
    distance = np.mean([np.linalg.norm(point) for point in results])
    return f"{distance:.2f}", f"{success.min():.0f} to {success.max():.0f}"


def main(
    runs: Annotated[int, typer.Option(help="Searches of each policy.")] = 10,
    budget: Annotated[int, typer.Option(help="Episodes of each search.")] = 300,
    cma_es: Annotated[bool, typer.Option("--cma-es", help="Also search by CMA-ES.")] = False,
) -> None:
    """Search the mildest failures of simulated policies."""
    methods = {"surface": surface_search} | ({"CMA-ES": cma_search} if cma_es else {})
    headings = [f"{name}: {column}" for name in methods for column in ("distance", "true success there, %")]
    table = versioned_table("disturbances", "policy", "true distance", *headings, "interval right", "above")
    for dimension in progress((2, 3, 5)):
        for name, odds in policies(dimension).items():
            cells: list[str] = []
            nearest, searches = true_distance(odds, dimension), list[Sequence[Point]]()
            for search in methods.values():
                points = [search(odds, dimension, budget, np.random.default_rng([run, 7])) for run in range(runs)]
                searches.append(points)
                cells += described(odds, points)
            cells += judged(odds, searches[0], dimension, nearest)
            table.add_row(str(dimension), name, f"{nearest:.2f}", *cells)
    show(table)


if __name__ == "__main__":
    typer.run(main)

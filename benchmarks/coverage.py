"""How often intervals and verdicts are right, on data like armctl's: mostly wins, and rare disasters.

    python benchmarks/coverage.py [--runs 2000] [--table means|success|pairs|trainings]

Each table simulates its method many times where the truth is known. Coverage is how often a 95 % interval holds it;
"too low" and "too high" are how often it lies wholly on that side, each of which should be at most 2.5 %. Wrong sign is
how often a policy is declared better that is not.
"""

import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.box import MARKDOWN
from rich.console import Console
from rich.table import Table
from scipy import stats

import armctl
from armctl.evaluation.paired import mcnemar, tango
from armctl.evaluation.statistics import Estimate, bounded_mean, mean, success_rate, worst_decile
from armctl.evaluation.trainings import mean_over_trainings

Array = NDArray[np.float64]

EPISODES = (20, 50, 200, 1000)
FAILURES = (0.0, 0.001, 0.005, 0.01, 0.05, 0.2, 0.5)
BOUNDS = (-100.0, 99.0)
"""Of the return of `armctl/ArmReach-v0`."""
WIN, LOSS = 88.0, -100.0
POPULATION = 1_000_000


def real_steps() -> Array:
    """Steps of the wins of `reach_ppo` in 200 episodes."""
    episodes = armctl.evaluate("reach_ppo", episodes=200, seed=0, worlds=50, least_lengths=False)
    return episodes.length[episodes.success].to_numpy(float)


def returns(kind: str, failures: float, steps: Array) -> Callable[[np.random.Generator, int], Array]:
    """A sampler of returns: bimodal ones, or those of real wins, with a share of failures."""

    def sample(rng: np.random.Generator, n: int) -> Array:
        won = WIN + rng.normal(0, 1, n) if kind == "bimodal" else 100 - rng.choice(steps, n)
        return np.where(rng.random(n) < failures, LOSS, won)

    return sample


def sides(found: list[Estimate], truth: float) -> tuple[str, str, str]:
    """Coverage, and how often the interval is too high and too low."""
    above = float(np.mean([one.low is not None and one.low > truth for one in found]))
    below = float(np.mean([one.high is not None and one.high < truth for one in found]))
    return f"{100 * (1 - above - below):.1f} %", f"{100 * below:.1f} %", f"{100 * above:.1f} %"


def means(runs: int) -> Iterator[tuple[str, ...]]:
    """Intervals of mean returns and of their worst tenth."""
    steps = real_steps()
    for kind in ("bimodal", "real"):
        for n in EPISODES:
            for failures in FAILURES:
                rng, sample = np.random.default_rng(0), returns(kind, failures, steps)
                truth = failures * LOSS + (1 - failures) * (WIN if kind == "bimodal" else 100 - float(steps.mean()))
                data = [sample(rng, n) for _ in range(runs if n < 1000 else runs // 2)]
                bounded = sides([_known(bounded_mean(values, BOUNDS)) for values in data], truth)
                students = sides([_known(mean(values)) for values in data], truth)
                worst = np.sort(sample(rng, POPULATION))[: POPULATION // 10].mean()
                decile = sides([_known(worst_decile(values, BOUNDS)) for values in data[: runs // 2]], float(worst))
                yield kind, f"{n:,}", f"{100 * failures:g} %", *bounded, students[0], decile[0]


def success(runs: int) -> Iterator[tuple[str, ...]]:
    """Exact coverage of intervals of a success rate, from the binomial distribution."""
    for n in EPISODES:
        failures = np.unique(np.concatenate((np.linspace(1e-4, 0.02, 200), np.linspace(0.02, 0.5, 200))))
        counts = np.arange(n + 1)
        probabilities = stats.binom.pmf(counts[:, None], n, failures)
        for name in ("exact", "wilson"):
            limits = np.array([_limits(int(k), n, name) for k in counts])
            held = (limits[:, :1] <= failures) & (failures <= limits[:, 1:])
            coverage = (probabilities * held).sum(axis=0)
            worst = int(coverage.argmin())
            widths = (limits[:, 1] - limits[:, 0]) @ stats.binom.pmf(counts, n, 0.01)
            yield (
                name, f"{n:,}", f"{100 * coverage[worst]:.1f} %", f"{100 * failures[worst]:.2f} %",
                f"{100 * coverage.mean():.1f} %", f"{100 * widths:.1f}",
            )  # fmt: skip


def _limits(failures: int, n: int, method: Any) -> tuple[float, float]:
    if method == "exact":
        found = _known(success_rate(np.arange(n) < failures))
        return found.low or 0.0, 1.0 if found.high is None else found.high
    interval = stats.binomtest(failures, n).proportion_ci(method=method)
    return float(interval.low), float(interval.high)


def pairs(runs: int) -> Iterator[tuple[str, ...]]:
    """Differences in success and return of two policies on the same episodes, and wrong verdicts on them.

    Policy b fails in a share of episodes in which a wins, and is a step faster in the others: it is worse by return.
    """
    for n in EPISODES:
        for only_a, only_b in ((0.0, 0.0), (0.005, 0.005), (0.01, 0.0), (0.02, 0.0), (0.05, 0.03), (0.2, 0.2)):
            rng = np.random.default_rng(0)
            counts = rng.multinomial(n, [only_a, only_b, 1 - only_a - only_b], size=runs)
            found = [tango(int(a), int(b), n) for a, b, _ in counts]
            wrong = np.mean([b > a and mcnemar(int(a), int(b)) < 0.05 for a, b, _ in counts])
            truth = (only_a - only_b) * (WIN - LOSS) - (1 - only_a - only_b)
            gains = [_gain(a, b, n) for a, b, _ in counts[: runs // 2]]
            spans = (BOUNDS[0] - BOUNDS[1], BOUNDS[1] - BOUNDS[0])
            bounded = [_known(bounded_mean(gain, spans)) for gain in gains]
            students = [_known(mean(gain)) for gain in gains]
            yield (
                f"{n:,}", f"{100 * only_a:g} %", f"{100 * only_b:g} %", *sides(found, only_a - only_b),
                f"{100 * wrong:.1f} %", sides(bounded, truth)[0], _wrong_sign(bounded, truth),
                _wrong_sign(students, truth),
            )  # fmt: skip


def _gain(only_a: int, only_b: int, n: int) -> Array:
    gain = np.full(n, -1.0)
    gain[:only_a], gain[only_a : only_a + only_b] = WIN - LOSS, LOSS - WIN
    return gain


def _wrong_sign(found: list[Estimate], truth: float) -> str:
    wrong = [one.high < 0 if truth > 0 else one.low > 0 for one in found if None not in (one.low, one.high)]  # type: ignore[operator]
    return f"{100 * float(np.mean(wrong)):.1f} %"


def trainings(runs: int) -> Iterator[tuple[str, ...]]:
    """Means over trainings that all played the same 200 episodes, which are hard or easy for all alike."""
    for k in (3, 5, 10):
        for spread in (0.0, 0.1, 0.3, 1.0):
            for rate, name in ((None, "returns"), (0.5, "success 50 %"), (0.95, "success 95 %")):
                rng = np.random.default_rng(0)
                found, pooled = [], []
                for _ in range(runs):
                    scores = spread * rng.normal(size=(k, 1)) + rng.normal(size=(1, 200)) + rng.normal(size=(k, 200))
                    if rate is not None:
                        scores = (scores < stats.norm.ppf(rate) * (2 + spread**2) ** 0.5).astype(float)
                    found.append(mean_over_trainings(scores).mean)
                    pooled.append(_known(mean(scores.ravel())))
                truth = rate or 0.0
                yield str(k), name, f"{spread:g}", *sides(found, truth), sides(pooled, truth)[0]


def _known(estimate: Estimate | None) -> Estimate:
    assert estimate is not None
    return estimate


TABLES = {
    "means": (
        means,
        ("returns", "episodes", "failures", "bounded mean", "too low", "too high", "Student's t", "worst tenth"),
    ),
    "success": (
        success,
        ("interval", "episodes", "least coverage", "at failures of", "mean coverage", "points wide at 1 %"),
    ),
    "pairs": (
        pairs,
        (
            "episodes", "only a wins", "only b wins", "Tango", "too low", "too high", "wrong sign, McNemar",
            "return: bounded mean", "wrong sign", "wrong sign, Student's t",
        ),
    ),
    "trainings": (
        trainings,
        ("trainings", "scores", "spread between them", "crossed", "too low", "too high", "episodes pooled"),
    ),
}  # fmt: skip


def main(runs: int = 2000, table: str = "") -> None:
    """Simulate, and print a table for each method."""
    for name, (simulate, columns) in TABLES.items():
        if table and name != table:
            continue
        start, shown = time.process_time(), Table(*columns, box=MARKDOWN)
        for row in simulate(runs):
            shown.add_row(*row)
        Console().print(shown)
        print(f"{name}: {runs} runs, armctl {armctl.__version__}, {time.process_time() - start:.0f} s of processor\n")


if __name__ == "__main__":
    typer.run(main)

"""Coverage of intervals and error rates of verdicts, on data like armctl's: mostly wins, and rare disasters.

    python benchmarks/intervals.py [--runs 2000] [--table means|bounds|success|pairs|unpaired|trainings]

Each table simulates its method many times where the truth is known. Coverage is how often a 95 % interval holds it;
"too low" and "too high" are how often it lies wholly on that side, each of which should be at most 2.5 %. Wrong sign is
how often a policy is declared better that is not. Where Student's t knows nothing, because nothing varied, it counts as
held. Random weights are drawn 1,000 times only, which makes single intervals less exact, and not their coverage.
"""

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np
import typer
from printing import show_simulations
from scipy import stats

import armctl
from armctl.core.arrays import Array
from armctl.stats import intervals as statistics
from armctl.stats.intervals import Bounds, Estimate, bounded_mean, success_rate, worst_decile
from armctl.stats.paired import mcnemar, mover
from armctl.stats.trainings import difference_over_trainings, mean_over_trainings, superiority_over_trainings
from armctl.stats.unpaired import newcombe, unconditional

EPISODES = (20, 50, 200, 1000)
FAILURES = (0.0, 0.001, 0.005, 0.01, 0.05, 0.2, 0.5)
BOUNDS = (-100.0, 99.0)
"""Bounds of the return of `armctl/ArmReach-v0`."""
WIN, LOSS = 88.0, -100.0
POPULATION = 1_000_000
DRAWS = 1000


def real_steps() -> Array:
    """Return the steps of the wins of `reach_ppo` in 200 episodes."""
    episodes = armctl.evaluate("reach_ppo", episodes=200, seed=0, worlds=50, lower_bound_steps=False)
    return episodes.length[episodes.success].to_numpy(float)


def returns(kind: str, failures: float, steps: Array) -> Callable[[np.random.Generator, int], Array]:
    """Return a sampler of returns: bimodal ones, or those of real wins, with a share of failures."""

    def sample(rng: np.random.Generator, n: int) -> Array:
        won = WIN + rng.normal(0, 1, n) if kind == "bimodal" else 100 - rng.choice(steps, n)
        return np.where(rng.random(n) < failures, LOSS, won)

    return sample


def sides(estimates: list[Estimate], truth: float) -> tuple[str, str, str]:
    """Return coverage, and how often the interval is too high and too low."""
    above = float(np.mean([estimate.low is not None and estimate.low > truth for estimate in estimates]))
    below = float(np.mean([estimate.high is not None and estimate.high < truth for estimate in estimates]))
    return f"{100 * (1 - above - below):.1f} %", f"{100 * below:.1f} %", f"{100 * above:.1f} %"


def means(runs: int) -> Iterator[tuple[str, ...]]:
    """Yield intervals of mean returns and of their worst tenth."""
    steps = real_steps()
    for kind in ("bimodal", "real"):
        for n in EPISODES:
            for failures in FAILURES:
                rng, sample = np.random.default_rng(0), returns(kind, failures, steps)
                truth = failures * LOSS + (1 - failures) * (WIN if kind == "bimodal" else 100 - float(steps.mean()))
                data = [sample(rng, n) for _ in range(runs if n < 1000 else runs // 2)]
                bounded = sides([_without_none(bounded_mean(values, BOUNDS)) for values in data], truth)
                students = sides([students_mean(values) for values in data], truth)
                worst = np.sort(sample(rng, POPULATION))[: POPULATION // 10].mean()
                decile = sides(
                    [_without_none(worst_decile(values, BOUNDS)) for values in data[: runs // 2]], float(worst)
                )
                yield kind, f"{n:,}", f"{100 * failures:g} %", *bounded, students[0], decile[0]


def success(runs: int) -> Iterator[tuple[str, ...]]:
    """Yield exact coverage of intervals of a success rate, from the binomial distribution."""
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
        estimate = _without_none(success_rate(np.arange(n) < failures))
        return estimate.low or 0.0, 1.0 if estimate.high is None else estimate.high
    interval = stats.binomtest(failures, n).proportion_ci(method=method)
    return float(interval.low), float(interval.high)


def pairs(runs: int) -> Iterator[tuple[str, ...]]:
    """Yield differences in success and return of two policies on the same episodes, and wrong verdicts on them.

    Policy b fails in a share of episodes in which a wins, and is a step faster in the others: it is worse by return.
    """
    for n in EPISODES:
        for only_a, only_b in ((0.0, 0.0), (0.005, 0.005), (0.01, 0.0), (0.02, 0.0), (0.05, 0.03), (0.2, 0.2)):
            rng = np.random.default_rng(0)
            counts = rng.multinomial(n, [only_a, only_b, 1 - only_a - only_b], size=runs)
            estimates = [mover(int(a), int(b), n) for a, b, _ in counts]
            wrong = np.mean([b > a and mcnemar(int(a), int(b)) < 0.05 for a, b, _ in counts])
            truth = (only_a - only_b) * (WIN - LOSS) - (1 - only_a - only_b)
            gains = [_gain(a, b, n) for a, b, _ in counts[: runs // 2]]
            spans = (BOUNDS[0] - BOUNDS[1], BOUNDS[1] - BOUNDS[0])
            bounded = [_without_none(bounded_mean(gain, spans)) for gain in gains]
            students = [students_mean(gain) for gain in gains]
            yield (
                f"{n:,}", f"{100 * only_a:g} %", f"{100 * only_b:g} %", *sides(estimates, only_a - only_b),
                f"{100 * wrong:.1f} %", sides(bounded, truth)[0], _wrong_sign(bounded, truth),
                _wrong_sign(students, truth),
            )  # fmt: skip


SIZES = ((10, 10), (20, 100), (100, 100), (50, 500), (1000, 1000))
"""Numbers of episodes of two policies that play different ones."""
SUCCESS = ((1.0, 1.0), (0.99, 0.99), (0.95, 0.95), (0.8, 0.8), (0.5, 0.5), (1.0, 0.97), (0.95, 0.85))
SPREADS = 3.0, 0.3
"""Standard deviations of the returns of both policies' wins. Their means are the same."""


def unpaired(runs: int) -> Iterator[tuple[str, ...]]:
    """Yield differences in success and return of two policies on different episodes, and how often tests find one.

    Where both succeed equally often, also neither return is higher with a probability of more than one half.
    """
    for rates in SUCCESS:
        for sizes in SIZES:
            rng = np.random.default_rng(0)
            several = runs if max(sizes) < 1000 else runs // 4
            wins = rng.binomial(sizes, rates, size=(several, 2)).tolist()
            counts = [(a, sizes[0], b, sizes[1]) for a, b in wins]
            barnard = [unconditional(*count) < 0.05 for count in counts]
            fisher = [_fisher(*count) < 0.05 for count in counts]
            returns, welch, higher, ranks = [], [], [], []
            for _ in range(runs // 10):
                a, b = (_returns(rng, *kind) for kind in zip(rates, sizes, SPREADS, strict=True))
                returns.append(statistics.bounded_sum([a, b], [1, -1], BOUNDS).estimate)
                welch.append(_welch(a, b))
                higher.append(superiority_over_trainings(a[None], b[None], paired=False)[0].p < 0.05)
                ranks.append(bool(stats.mannwhitneyu(a, b).pvalue < 0.05))
            difference = rates[0] - rates[1]
            gain = difference * (WIN - LOSS)
            yield (
                " / ".join(f"{100 * rate:g}" for rate in rates), " / ".join(f"{n:,}" for n in sizes),
                *sides([newcombe(*count) for count in counts], difference), _share(barnard), _share(fisher),
                *sides(returns, gain), sides(welch, gain)[0], _share(higher), _share(ranks),
            )  # fmt: skip


def _returns(rng: np.random.Generator, rate: float, n: int, spread: float) -> Array:
    away = np.clip(rng.normal(0, spread, n), WIN - BOUNDS[1], BOUNDS[1] - WIN)
    return np.where(rng.random(n) < rate, WIN + away, LOSS)


@cache
def _fisher(wins_a: int, episodes_a: int, wins_b: int, episodes_b: int) -> float:
    table = np.array([[wins_a, wins_b], [episodes_a - wins_a, episodes_b - wins_b]])
    return float(stats.fisher_exact(table).pvalue)


def _welch(a: Array, b: Array) -> Estimate:
    interval = stats.ttest_ind(a, b, equal_var=False).confidence_interval()
    return Estimate(float(a.mean() - b.mean()), float(interval.low), float(interval.high))


def _share(happened: list[bool]) -> str:
    return f"{100 * float(np.mean(happened)):.1f} %"


def _gain(only_a: int, only_b: int, n: int) -> Array:
    gain = np.full(n, -1.0)
    gain[:only_a], gain[only_a : only_a + only_b] = WIN - LOSS, LOSS - WIN
    return gain


def _wrong_sign(estimates: list[Estimate], truth: float) -> str:
    wrong = [
        estimate.high < 0 if truth > 0 else estimate.low > 0
        for estimate in estimates
        if None not in (estimate.low, estimate.high)
    ]
    return f"{100 * float(np.mean(wrong)):.1f} %"


POPULATIONS: dict[str, tuple[Callable[[np.random.Generator, int], Array], float]] = {
    "all alike": (lambda rng, k: np.full(k, 0.95), 0.95),
    "normal, spread 5 points": (lambda rng, k: rng.normal(0.8, 0.05, k), 0.8),
    "skewed (beta), spread 13 points": (lambda rng, k: rng.beta(1.9, 0.1, k), 0.95),
    "1 in 5 fails altogether": (lambda rng, k: np.where(rng.random(k) < 0.2, 0.0, 0.99), 0.792),
    "1 in 10 fails altogether": (lambda rng, k: np.where(rng.random(k) < 0.1, 0.0, 0.99), 0.891),
}
"""A sampler of the success rates of trainings, and their mean."""
EXPERT = 0.98
"""Success of the policy that the group is held against."""


def trained(rng: np.random.Generator, rates: Array, n: int) -> Array:
    """Return successes (k, n) of trainings of these rates (k, 1); one half of the episodes is hard or easy for all."""
    shared = np.repeat(rng.random((1, n // 2)), len(rates), axis=0)
    return (np.hstack((shared, rng.random((len(rates), n - n // 2)))) < rates).astype(float)


def trainings(runs: int) -> Iterator[tuple[str, ...]]:
    """Yield success over trainings that all played the same episodes, and their difference from an expert's."""
    for name, (sample, rate) in POPULATIONS.items():
        for k in (3, 5, 10):
            for n in (200, 1000, 5000):
                rng, results, against = np.random.default_rng(0), [], []
                for _ in range(runs // 20):
                    successes = trained(rng, np.append(sample(rng, k), EXPERT)[:, None], n)
                    results.append(mean_over_trainings(successes[:-1], (0.0, 1.0)))
                    against.append(difference_over_trainings(successes[:-1], successes[-1:], (0.0, 1.0)))
                weighted, students = (
                    [estimate.mean for estimate in results],
                    [estimate.if_normal for estimate in results],
                )
                wrong = [estimate.estimate for estimate in against if estimate.p is not None and estimate.p < 0.05]
                sign = sum(estimate.value * (rate - EXPERT) < 0 for estimate in wrong) / len(against)
                yield (
                    name, f"{100 * rate:g} %", str(k), f"{n:,}", *sides(weighted, rate), _width(weighted),
                    *sides(students, rate), _width(students),
                    sides([estimate.estimate for estimate in against], rate - EXPERT)[0], f"{100 * sign:.1f} %",
                )  # fmt: skip


RETURNS: dict[str, tuple[Callable[[np.random.Generator, int], Array], Bounds]] = {
    "normal": (lambda rng, n: np.clip(rng.normal(0, 10, n), -60, 60), (-60.0, 60.0)),
    "skewed (exponential)": (lambda rng, n: np.minimum(rng.exponential(10, n), 200), (0.0, 200.0)),
    "88, -100 in 1 %": (lambda rng, n: np.where(rng.random(n) < 0.01, -100.0, rng.normal(88, 1, n)), BOUNDS),
    "1, -1,000 in 2 %": (lambda rng, n: np.where(rng.random(n) < 0.02, -1000.0, 1.0), (-1000.0, 1.0)),
}
"""A sampler of returns, and the bounds that they have."""


def unknown_bounds(runs: int) -> Iterator[tuple[str, ...]]:
    """Yield the coverage of means and worst tenths without bounds: with the sample's bounds it is far too low."""
    for name, (sample, bounds) in RETURNS.items():
        rng = np.random.default_rng(0)
        everything = np.sort(sample(rng, POPULATION))
        truths = float(everything.mean()), float(everything[: POPULATION // 10].mean())
        for n in (20, 50, 200):
            data = [sample(rng, n) for _ in range(runs // 10)]
            cells: list[str] = []
            statistics_of: tuple[Callable[[Array, Bounds], Estimate | None], ...] = (bounded_mean, worst_decile)
            for statistic, truth in zip(statistics_of, truths, strict=True):
                for stated in (bounds, None):
                    limits = [stated or (float(draws.min()), float(draws.max())) for draws in data]
                    estimates = [_without_none(statistic(draws, two)) for draws, two in zip(data, limits, strict=True)]
                    cells += sides(estimates, truth)
            yield name, f"{n:,}", *cells


def _width(estimates: list[Estimate]) -> str:
    """Return the median, in points, where there is an interval."""
    widths = [
        estimate.high - estimate.low for estimate in estimates if estimate.low is not None and estimate.high is not None
    ]
    return f"{100 * float(np.median(widths)):.0f}"


def students_mean(values: Array) -> Estimate:
    """Return a mean with Student's interval, which is far too narrow where disasters are rare."""
    value, half = float(values.mean()), float(stats.sem(values) * stats.t.ppf(0.975, len(values) - 1))
    return Estimate(value, value - half, value + half)


def _without_none(estimate: Estimate | None) -> Estimate:
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
            "episodes", "only a wins", "only b wins", "success: MOVER", "too low", "too high", "wrong sign, McNemar",
            "return: bounded mean", "wrong sign", "wrong sign, Student's t",
        ),
    ),
    "unpaired": (
        unpaired,
        (
            "success, %", "episodes", "success: Newcombe", "too low", "too high", "p < 5 %, Barnard", "p < 5 %, Fisher",
            "return: distribution-free", "too low", "too high", "Welch", "higher return: p < 5 %, distribution-free",
            "p < 5 %, Mann-Whitney",
        ),
    ),
    "bounds": (
        unknown_bounds,
        (
            "returns", "episodes", "mean, bounds known", "too low", "too high", "bounds of the sample taken as bounds",
            "too low", "too high", "worst tenth, bounds known", "too low", "too high",
            "bounds of the sample taken as bounds", "too low", "too high",
        ),
    ),
    "trainings": (
        trainings,
        (
            "population of trainings", "success", "trainings", "episodes", "distribution-free", "too low", "too high",
            "points wide", "Student's t", "too low", "too high", "points wide", "difference", "wrong sign",
        ),
    ),
}  # fmt: skip


def main(runs: int = 2000, table: str = "") -> None:
    """Simulate, and print a table for each method."""
    statistics.DRAWS = DRAWS
    show_simulations(TABLES, runs, table)


if __name__ == "__main__":
    typer.run(main)

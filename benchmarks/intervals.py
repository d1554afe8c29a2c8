"""How often intervals and verdicts are right, on data like armctl's: mostly wins, and rare disasters.

    python benchmarks/intervals.py [--runs 2000] [--table means|success|pairs|trainings]

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
from armctl.evaluation.paired import mcnemar, mover
from armctl.evaluation.statistics import Estimate, bounded_mean, mean, success_rate, worst_decile
from armctl.evaluation.trainings import difference_over_trainings, mean_over_trainings

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
            found = [mover(int(a), int(b), n) for a, b, _ in counts]
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


SPREADS = (
    (0.5, 0.1), (0.8, 0.2), (0.95, 0.0), (0.95, 0.03), (0.95, 0.06), (0.95, 0.2), (0.99, 0.01), (0.99, 0.05),
    (0.85, None),
)  # fmt: skip
"""Mean success, and its standard deviation between trainings; None: one training in ten fails altogether."""
EXPERT = 0.98
"""Success of the policy that the group is held against."""


def trained(rng: np.random.Generator, k: int, n: int, rate: float, spread: float | None) -> tuple[Array, Array]:
    """Successes (k, n) of trainings, whose rates are beta-distributed, and (1, n) of an expert.

    Episodes are hard or easy for all alike.
    """
    if spread is None:
        rates = np.where(rng.random(k) < 0.1, 0.0, rate / 0.9)
    elif spread == 0:
        rates = np.full(k, rate)
    else:
        both = rate * (1 - rate) / spread**2 - 1
        rates = rng.beta(rate * both, (1 - rate) * both, k)
    ease = rng.normal(size=(1, n)) + rng.normal(size=(k + 1, n))
    won = ease / 2**0.5 < stats.norm.ppf(np.append(rates, EXPERT))[:, None]
    return won[:-1].astype(float), won[-1:].astype(float)


def trainings(runs: int) -> Iterator[tuple[str, ...]]:
    """Success over trainings that all played the same episodes, and their difference from an expert's."""
    n = 200
    for k in (3, 5, 10):
        for rate, spread in SPREADS:
            rng = np.random.default_rng(0)
            data = [trained(rng, k, n, rate, spread) for _ in range(runs // 10)]
            found = [mean_over_trainings(group, (0.0, 1.0)).mean for group, _ in data]
            students = [mean_over_trainings(group).mean for group, _ in data]
            against = [difference_over_trainings(group, expert, (0.0, 1.0)) for group, expert in data]
            wrong = [one.p < 0.05 and one.estimate.value * (rate - EXPERT) < 0 for one in against]
            yield (
                str(k), f"{n:,}", f"{100 * rate:g} %", "1 in 10 fails" if spread is None else f"{100 * spread:g}",
                *sides(found, rate), _width(found), sides(students, rate)[0], _width(students),
                sides([one.estimate for one in against], rate - EXPERT)[0], f"{100 * float(np.mean(wrong)):.1f} %",
            )  # fmt: skip


def _width(found: list[Estimate]) -> str:
    """Median, in points."""
    return f"{100 * float(np.median([one.high - one.low for one in found])):.0f}"  # type: ignore[operator]


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
            "episodes", "only a wins", "only b wins", "success: MOVER", "too low", "too high", "wrong sign, McNemar",
            "return: bounded mean", "wrong sign", "wrong sign, Student's t",
        ),
    ),
    "trainings": (
        trainings,
        (
            "trainings", "episodes", "success", "spread, points", "crossed", "too low", "too high", "points wide",
            "Student's t", "points wide", "difference", "wrong sign",
        ),
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

"""Errors, coverage and power of `compare --until decided`, on pairs of episodes like armctl's: mostly wins.

    python benchmarks/sequential.py [--runs 1000] [--table errors|power|looks|real|priors|blocks]

Each row simulates pairs of episodes whose truth is known. Outcomes of a pair are independent of those of other pairs;
those of two policies in the same episode are independent too, unless a row states the share of discordant episodes.
"Ever" is at any number of episodes up to `MAX_EPISODES`: somebody looks after each, and stops at the first claim.
"""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import scipy
import typer
from numpy.typing import NDArray
from printing import show_simulations
from scipy import stats

import armctl
from armctl.core.arrays import Array
from armctl.stats import sequential
from armctl.stats.difference import LEVELS, MARGIN, within
from armctl.stats.paired import mover
from armctl.stats.power import episodes_to_detect, episodes_to_show_equivalence
from armctl.stats.sequential import block_ends

MAX_EPISODES = 2000
"""Episodes of each simulated comparison."""
SIDE = 0.025
"""Level of either side of a test or an interval."""
NEVER = 10**9
PAIRS = {
    "50 %": 0.5, "70 %": 0.42, "80 %": 0.32, "90 %": 0.18, "95 %": 0.095, "98 %": 0.0392, "99 %": 0.0198,
    "99.5 %": 0.00995, "100 %": 0.0, "95 %, same failures mostly": 0.02, "98 %, same failures mostly": 0.01,
}  # fmt: skip
"""Share of discordant episodes of two policies that have the same rate of success."""


def differences(only_a: float, only_b: float, runs: int, seed: int = 0, episodes: int = MAX_EPISODES) -> Array:
    """Return success of a minus that of b, (runs, episodes)."""
    u = np.random.default_rng(seed).random((runs, episodes))
    return np.where(u < only_a, 1.0, np.where(u < only_a + only_b, -1.0, 0.0))


def refuted(values: Array, mean: float, tail: float, bounds: tuple[float, float] = (-1.0, 1.0)) -> NDArray[np.int64]:
    """Return after how many of the values (runs, n) a mean of at most `mean` is refuted at the level `tail`.

    It is `NEVER` where it is not. As `ConfidenceSequence`, for many sequences at once.
    """
    shares, share = ((x - bounds[0]) / (bounds[1] - bounds[0]) for x in (values, mean))
    capital = np.zeros(values.shape)
    for bet, weight in zip(*sequential._bets(), strict=True):
        with np.errstate(over="ignore"):
            capital += np.exp(weight) * np.cumprod(1.0 + bet * (shares / share - 1.0), axis=1)
    reached = capital >= 1 / tail
    return np.where(reached.any(axis=1), reached.argmax(axis=1) + 1, NEVER)


def claimed(values: Array, margin: float = MARGIN) -> tuple[NDArray[np.int64], ...]:
    """Return after how many episodes a is better, b is better, and both are equivalent, each (runs,)."""
    better, worse = refuted(values, 0.0, SIDE), refuted(-values, 0.0, SIDE)
    equivalent = np.maximum(refuted(values, -margin, 2 * SIDE), refuted(-values, -margin, 2 * SIDE))
    return better, worse, equivalent


def mcnemars_p(only_a: Any, only_b: Any) -> Any:
    """Return p-values of `armctl.stats.paired.mcnemar`, for many pairs at once."""
    return np.minimum(1.0, 2 * scipy.special.bdtr(np.minimum(only_a, only_b), only_a + only_b, 0.5))


def fixed_test(values: Array, looks: Sequence[int]) -> NDArray[np.int64]:
    """Return after how many episodes McNemar's exact test, at these looks, first claims a difference."""
    won, lost = np.cumsum(values > 0, axis=1), np.cumsum(values < 0, axis=1)
    first = np.full(len(values), NEVER)
    for n in reversed(looks):
        p = mcnemars_p(won[:, n - 1], lost[:, n - 1])
        first[p < 2 * SIDE] = n
    return first


def percent(share: Any) -> str:
    """Return a share in percent."""
    return f"{100 * share:.1f} %"


def errors(runs: int) -> Iterator[tuple[str, ...]]:
    """Yield how often equal policies, and those 2 points apart, are judged wrongly by somebody who always looks."""
    for name, discordant in PAIRS.items():
        equal = differences(discordant / 2, discordant / 2, runs)
        better, worse, _ = claimed(equal)
        tens, doubling = range(10, MAX_EPISODES + 1, 10), [10 * 2**k for k in range(8)]
        shift = max(MARGIN - discordant, 0.0)  # only one of the two wins at least as often as they differ
        apart = differences((discordant + MARGIN + shift) / 2, (discordant - MARGIN + shift) / 2, runs, 1)
        misses = np.minimum(refuted(apart, MARGIN, SIDE), refuted(-apart, -MARGIN, SIDE))
        claims = np.minimum(better, worse), misses, claimed(apart)[2]
        tests = [fixed_test(equal, looks) for looks in ([MAX_EPISODES], doubling, tens)]
        shares = [float(np.mean(first <= MAX_EPISODES)) for first in (*claims, *tests)]
        yield name, percent(discordant), *map(percent, (shares[0], 1 - shares[1], *shares[2:]))
    for kind, returns in RETURNS.items():
        bounds = (-199.0, 199.0)
        values = returns(np.random.default_rng(0), (runs // 2, MAX_EPISODES)).clip(*bounds)
        ever = np.minimum(refuted(values, 0.0, SIDE, bounds), refuted(-values, 0.0, SIDE, bounds)) <= MAX_EPISODES
        every = [_students_p(values[:, :n]) < 2 * SIDE for n in range(10, MAX_EPISODES + 1, 10)]
        doubled = [_students_p(values[:, :n]) < 2 * SIDE for n in doubling]
        yield (
            f"returns: {kind}", "", percent(ever.mean()), percent(1 - ever.mean()), "", percent(every[-1].mean()),
            percent(np.any(doubled, axis=0).mean()), percent(np.any(every, axis=0).mean()),
        )  # fmt: skip


RETURNS: dict[str, Callable[[np.random.Generator, tuple[int, int]], Array]] = {
    "1 % disasters on either side": lambda rng, shape: rng.normal(0, 5, shape) + 188 * _rare(rng, shape, 0.01),
    "1 less, and 188 more in 0.5 %": lambda rng, shape: np.where(rng.random(shape) < 1 / 189, 188.0, -1.0),
}
"""A sampler of differences in return whose mean is 0."""


def _rare(rng: np.random.Generator, shape: tuple[int, int], share: float) -> Array:
    return rng.choice([1.0, 0.0, -1.0], p=[share / 2, 1 - share, share / 2], size=shape)


def _students_p(values: Array) -> Array:
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.nan_to_num(np.asarray(stats.ttest_1samp(values, 0.0, axis=1).pvalue), nan=1.0)


DIFFERENT = (
    (0.02, 0.0), (0.03, 0.01), (0.05, 0.0), (0.05, 0.01), (0.1, 0.0), (0.1, 0.05), (0.2, 0.1), (0.3, 0.05), (0.9, 0.0),
)  # fmt: skip
EQUIVALENT = ((0.0, 0.0), (0.001, 0.001), (0.0025, 0.0025), (0.005, 0.005), (0.01, 0.01))


def power(runs: int) -> Iterator[tuple[str, ...]]:
    """Yield the episodes until a decision, beside those of a fixed design with a power of 80 %."""
    for only_a, only_b in (*DIFFERENT, *EQUIVALENT):
        episodes = 3 * MAX_EPISODES if only_a == only_b else MAX_EPISODES
        better, worse, equivalent = claimed(differences(only_a, only_b, runs // 4, episodes=episodes))
        differ = only_a > only_b
        fixed = (
            episodes_to_detect(only_a - only_b, only_a + only_b)
            if differ
            else episodes_to_show_equivalence(MARGIN, only_a + only_b)
        )
        right = better if differ else equivalent
        ends = np.array(block_ends(episodes))
        stop = np.minimum(np.minimum(better, worse), equivalent)
        stopped = np.minimum(ends[np.minimum(np.searchsorted(ends, stop), len(ends) - 1)], episodes)
        yield (
            percent(only_a), percent(only_b), "better" if differ else "equivalent", f"{fixed:,}",
            percent(np.mean(right <= fixed)), _median(right), _median(np.where(stop <= episodes, stopped, NEVER)),
            f"{np.quantile(right, 0.8):,.0f}" if np.mean(right <= episodes) > 0.8 else "-",
            percent(np.mean(np.minimum(stop, episodes)) / fixed),
        )  # fmt: skip


def _median(episodes: NDArray[np.int64]) -> str:
    median = float(np.median(episodes))
    return "-" if median >= NEVER else f"{median:,.0f}"


@functools.cache
def advised(episodes: int, discordant: int) -> int:
    """Return the number of episodes that a verdict advises, as `armctl.verdict.sentences` does."""
    share = (discordant + 1) / (episodes + 2)
    needed = max(episodes_to_detect(MARGIN, share), episodes_to_show_equivalence(MARGIN, share))
    more = max(needed - episodes, episodes // 2)
    return episodes + round(more, 1 - len(str(more)))


LONGEST = 6000
"""Episodes of a comparison to which somebody adds some."""
PROTOCOLS: dict[str, Callable[[int, int], int]] = {
    "about N more, as advised": advised,
    "twice as many": lambda episodes, discordant: 2 * episodes,
    "ten more": lambda episodes, discordant: episodes + 10,
}


def looks(runs: int) -> Iterator[tuple[str, ...]]:
    """Yield how often equal policies are called different by who adds episodes while the verdict is undecided."""
    for first in (20, 100):
        for name in ("50 %", "80 %", "90 %", "95 %", "98 %"):
            values = differences(PAIRS[name] / 2, PAIRS[name] / 2, runs // 2, episodes=LONGEST)
            anytime = np.minimum(refuted(values, 0.0, SIDE), refuted(-values, 0.0, SIDE))
            cells = []
            for more in PROTOCOLS.values():
                claims = np.array([_looked(run, at, first, more) for run, at in zip(values, anytime, strict=True)])
                cells += [percent(share) for share in claims.mean(axis=0)]
            yield str(first), name, *cells


def _looked(values: Array, anytime: int, first: int, more: Callable[[int, int], int]) -> tuple[bool, bool, bool]:
    """Return if a difference is claimed by fixed tests alone, by verdicts as printed, and by those that were resumed.

    The verdict of the first look is that of the fixed test; resumed ones hold at any number of episodes.
    """
    won, lost = np.cumsum(values > 0), np.cumsum(values < 0)
    first_claim = bool(mcnemars_p(won[first - 1], lost[first - 1]) < 2 * SIDE)
    episodes, fixed_claim, resumed_claim = first, first_claim, False
    while episodes <= len(values) and not (fixed_claim and (first_claim or resumed_claim)):
        a, b = int(won[episodes - 1]), int(lost[episodes - 1])
        fixed_claim |= bool(mcnemars_p(a, b) < 2 * SIDE)
        resumed_claim |= episodes > first and anytime <= episodes
        if within(mover(a, b, episodes, 1 - 4 * SIDE), MARGIN):
            break
        episodes = more(episodes, a + b)
    return fixed_claim, first_claim or resumed_claim, resumed_claim


def priors(runs: int) -> Iterator[tuple[str, ...]]:
    """Yield the median number of episodes by the parameter of the prior."""
    chosen, values = sequential.PRIOR, (0.1, 0.25, 0.5, 1.0, 2.0)
    for only_a, only_b in (*DIFFERENT, *EQUIVALENT):
        pairs, cells = differences(only_a, only_b, runs // 10), []
        for prior in values:
            sequential.PRIOR = prior
            sequential._bets.cache_clear()
            better, _, equivalent = claimed(pairs)
            cells.append(_median(better if only_a > only_b else equivalent))
        yield percent(only_a), percent(only_b), *cells
    sequential.PRIOR = chosen
    sequential._bets.cache_clear()


SCHEDULES: dict[str, Callable[[], list[int]]] = {
    "10 each": lambda: [*range(10, MAX_EPISODES + 1, 10)],
    "50 each": lambda: [*range(50, MAX_EPISODES + 1, 50)],
    "10 each, or a tenth of all (chosen)": lambda: block_ends(MAX_EPISODES),
    "a quarter more each": lambda: [min(MAX_EPISODES, round(10 * 1.25**k)) for k in range(26)],
    "half as many more each": lambda: [min(MAX_EPISODES, round(10 * 1.5**k)) for k in range(15)],
    "twice as many each": lambda: [min(MAX_EPISODES, 10 * 2**k) for k in range(9)],
}


def blocks(runs: int) -> Iterator[tuple[str, ...]]:
    """Yield the mean number of episodes over `DIFFERENT` and `EQUIVALENT` pairs, and how many blocks that takes."""
    stops = [
        np.minimum.reduce(claimed(differences(only_a, only_b, runs // 10))).clip(max=MAX_EPISODES)
        for only_a, only_b in (*DIFFERENT, *EQUIVALENT)
    ]
    exact = np.mean([stop.mean() for stop in stops])
    for name, schedule in SCHEDULES.items():
        ends = np.array(schedule())
        places = [np.searchsorted(ends, stop).clip(max=len(ends) - 1) for stop in stops]
        mean = np.mean([ends[place].mean() for place in places])
        number = np.mean([place.mean() + 1 for place in places])
        yield name, f"{mean:,.0f}", percent(mean / exact - 1), f"{number:.1f}"


REAL = (
    ("armctl/ArmReach-v0", "reach_ik", "random"),
    ("armctl/ArmReach-v0", "reach_ik", "reach_ppo"),
    ("armctl/BridgeCross-v0", "bridge_mpc", "bridge_ppo"),
)
"""Environment and two policies: one of them clearly better, both equivalent, and about 2 points apart."""


AT_MOST = 500
"""Episodes of a real comparison at most."""


def real(runs: int) -> Iterator[tuple[str, ...]]:
    """Yield what `compare --until decided --at-most` says of policies on seed 0, and a fixed design for 2 points."""
    for env, a, b in REAL:
        comparison = armctl.compare([a, b], env, episodes=AT_MOST, until="decided", seed=0, worlds=20)
        (pair,) = comparison.differences
        num_episodes = comparison.facts.planned
        share = (pair.only_a + pair.only_b + 1) / (pair.episodes + 2)
        fixed = max(episodes_to_detect(MARGIN, share, tests=LEVELS), episodes_to_show_equivalence(MARGIN, share))
        verdict = comparison.verdict.result.partition(";")[0] if comparison.verdict else ""
        yield f"{a}, {b}", verdict, f"{pair.only_a} / {pair.only_b}", f"{num_episodes:,}", f"{fixed:,}"


TABLES = {
    "errors": (
        errors,
        (
            "both succeed in", "discordant", "ever *better*, equal policies", "interval always right",
            "ever *equivalent*, 2 points apart", "fixed test, once", "looking at doublings", "looking after every 10",
        ),
    ),
    "power": (
        power,
        (
            "only a wins", "only b wins", "claim", "fixed design, power 80 %", "claimed by then", "median episodes",
            "median, in blocks", "claimed in 80 % after", "mean, of the fixed",
        ),
    ),
    "looks": (
        looks,
        (
            "first look", "both succeed in",
            *(f"{name}{of}" for name in PROTOCOLS for of in (": fixed test", ": as printed", ", when resumed")),
        ),
    ),
    "priors": (priors, ("only a wins", "only b wins", "beta 0.1", "0.25 (chosen)", "0.5", "1", "2")),
    "real": (real, ("policies", "verdict", "only a / only b", "episodes", "fixed design for 2 points")),
    "blocks": (blocks, ("blocks", "mean episodes", "more than after each episode", "mean number of blocks")),
}  # fmt: skip


def main(runs: int = 1000, table: str = "") -> None:
    """Simulate, and print a table for each question."""
    show_simulations(TABLES, runs, table)


if __name__ == "__main__":
    typer.run(main)

"""Number of episodes that a comparison needs."""

from dataclasses import dataclass, field
from pathlib import Path

from armctl.core.errors import ConfigurationError, ResultsError
from armctl.stats.difference import LEVELS
from armctl.stats.power import episodes_to_detect, episodes_to_show_equivalence
from armctl.verdict.tables import AGAINST, UNKNOWN, Cell, Column, Document, Remark, Table

SHARES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
"""Shares of episodes that exactly one of two policies wins."""
COUNTS = ("episodes_to_detect", "episodes_to_show_equivalence")
MIN_DIFFERENCE, MAX_POWER, MAX_PAIRS = 0.001, 0.9999, 10**6
"""Limits on what is planned for, which takes up to 40 s there; the pairs are those of 1,400 policies."""
TRAININGS = "For groups of trainings, more trainings tell more than more episodes"


@dataclass(frozen=True)
class _Planned:
    """Pairs and tests that a number of episodes is planned for."""

    shares: dict[Cell, float]
    """Shares of discordant episodes, by the name of a row."""
    tests: int = LEVELS
    """Number of tests for which the verdict corrects a difference."""
    num_comparisons: int = 1
    """Number of pairs for which it corrects equivalence."""
    left_out: list[str] = field(default_factory=list)
    """Pairs that more episodes alone do not decide."""


def plan_comparison(
    difference: float, power: float = 0.8, pilot: Path | None = None, pairs: int | None = None
) -> Document:
    """Compute how many episodes show a difference in success, or that there is none as large.

    `power` is the probability of telling it. With the results folder of a pilot, there is a row for each pair of its
    policies, whose share of discordant episodes is estimated with one more of either kind (Laplace's rule). Tests are
    corrected for success, steps and return of so many `pairs` (Bonferroni); by default, as the pilot's verdict is, or
    for a single pair without one.

    Raises `ConfigurationError`, and `ResultsError` for a folder without results of success.
    """
    if not MIN_DIFFERENCE <= difference < 1:
        smallest = 100 * MIN_DIFFERENCE
        raise ConfigurationError(f"the difference to detect is from {smallest:g} to 100 %, not {100 * difference:g} %")
    if not 0 < power <= MAX_POWER:
        raise ConfigurationError(f"the power is a probability up to {MAX_POWER}, such as 0.8, not {power:.10g}")
    if pairs is not None and not 1 <= pairs <= MAX_PAIRS:
        raise ConfigurationError(f"a comparison has from one to {MAX_PAIRS:,} pairs, not {pairs:,}")
    plan = _Planned({Cell(f"{100 * share:g} %"): share for share in SHARES}) if pilot is None else _planned(pilot)
    tests, num_comparisons = LEVELS * pairs if pairs else plan.tests, pairs or plan.num_comparisons
    min_share = difference if pilot is None else 0.0
    records = [
        {
            "pair": f"{name.text} {name.small}".strip(),
            "discordant": share,
            COUNTS[0]: None if share < min_share else episodes_to_detect(difference, share, power, tests),
            COUNTS[1]: episodes_to_show_equivalence(difference, share, power, num_comparisons),
        }
        for name, share in plan.shares.items()
    ]
    rows = [
        [name, *([] if pilot is None else [Cell(f"{100 * share:.1f} %")])]
        + [Cell(f"{n:,}" if n else UNKNOWN) for n in (record[key] for key in COUNTS)]
        for (name, share), record in zip(plan.shares.items(), records, strict=True)
    ]
    points = f"{100 * difference:g} points"
    headings = ["won by exactly one"] if pilot is None else ["a - b", "won by exactly one"]
    columns = [*map(Column, headings), Column("to detect"), Column("to show equivalence")]
    title = f"Episodes that tell {points} of success, with a power of {100 * power:g} %"
    remarks = [
        "Two policies of 95 and 97 % whose failures are independent differ in 7.7 % of their episodes."
        if pilot is None
        else "Play them with another seed, or with the pilot's, which resumes it."
    ]
    if any(share < difference for share in plan.shares.values()):
        remarks.append(
            f"Policies that differ by {points} differ in at least {100 * difference:g} % of their episodes"
            + ("." if pilot is None else ", which is what detecting it is planned for.")
        )
    if plan.left_out:
        remarks.append(f"Left out: {', '.join(plan.left_out)}. {TRAININGS}.")
    table = Table("plan", title, columns, rows, records, _caption(tests, num_comparisons))
    return Document([table, *map(Remark, remarks)], {"difference": difference, "power": power})


def _caption(tests: int, num_comparisons: int) -> str:
    """Return a caption that states the corrections of the tests."""
    corrections = f"to detect, for {tests} test{'s' * (tests > 1)} of success, steps and return; "
    corrections += f"to show equivalence, for {num_comparisons} pair{'s' * (num_comparisons > 1)}"
    return f"Tests at 5 % after Bonferroni's correction ({corrections}), on the same episodes for both policies."


def _planned(pilot: Path) -> _Planned:
    from armctl.study.results import read_comparison  # with tables of episodes, which no other plan needs
    from armctl.verdict.sentences import verdict_pairs

    pilot_results = read_comparison(pilot)
    pairs_by_success = [
        pair
        for pair in pilot_results.differences
        if pair.success_p is not None and pilot_results.facts.baseline in (None, pair.a, pair.b)
    ]
    left_out = [f"{pair.a} {AGAINST}{pair.b}" for pair in pairs_by_success if pair.crossed is not None]
    policy_pairs = {Cell(pair.a, AGAINST + pair.b): pair for pair in pairs_by_success if pair.crossed is None}
    if not policy_pairs:
        why = f": {TRAININGS}" if left_out else ""
        raise ResultsError(f"{pilot} has no pair of policies whose success is known, and so nothing to plan by{why}")
    shares = {name: (pair.only_a + pair.only_b + 1) / (pair.episodes + 2) for name, pair in policy_pairs.items()}
    pair = verdict_pairs(pilot_results.policies, pilot_results.differences, pilot_results.facts.baseline)[0]
    return _Planned(shares, pair.p.tests, pair.num_comparisons, left_out)

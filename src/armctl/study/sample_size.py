"""Number of episodes that a comparison needs."""

from dataclasses import dataclass, field, replace
from pathlib import Path

from armctl.core.errors import ConfigurationError, ResultsError
from armctl.stats.difference import LEVELS
from armctl.stats.power import episodes_to_detect, episodes_to_show_equivalence
from armctl.verdict.tables import AGAINST, UNKNOWN, Cell, Column, Document, Remark, Table

SHARES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
"""Shares of episodes that exactly one of two policies wins."""
RATES = (0.5, 0.7, 0.8, 0.9, 0.95, 0.98)
"""Mean success rates of two policies that play different episodes."""
COUNTS = ("episodes_to_detect", "episodes_to_show_equivalence")
MIN_DIFFERENCE, MAX_POWER, MAX_PAIRS = 0.001, 0.9999, 10**6
"""Limits on what is planned for, which takes up to 40 s there; the pairs are those of 1,400 policies."""
TRAININGS = "For groups of trainings, more trainings tell more than more episodes"


@dataclass(frozen=True)
class _Planned:
    """Pairs and tests that a number of episodes is planned for."""

    shares: dict[Cell, float]
    """Shares of discordant episodes, or mean success rates of different episodes, by the name of a row."""
    tests: int = LEVELS
    """Number of tests for which the verdict corrects a difference."""
    num_comparisons: int = 1
    """Number of pairs for which it corrects equivalence."""
    left_out: list[str] = field(default_factory=list)
    """Pairs that more episodes alone do not decide."""
    paired: bool = True
    """True if policies play the same episodes."""

    def is_possible(self, share: float, difference: float) -> bool:
        """Return True if policies with such a share can differ by so much."""
        return share >= difference if self.paired else min(share, 1 - share) >= difference / 2 - 1e-9


def plan_comparison(
    difference: float,
    power: float = 0.8,
    pilot: Path | None = None,
    pairs: int | None = None,
    unpaired: bool = False,
) -> Document:
    """Compute how many episodes show a difference in success, or that there is none as large.

    `power` is the probability of telling it. With the results folder of a pilot, there is a row for each pair of its
    policies, whose share of discordant episodes is estimated with one more of either kind (Laplace's rule). Tests are
    corrected for success, steps and return of so many `pairs` (Bonferroni); by default, as the pilot's verdict is, or
    for a single pair without one. If policies are `unpaired`, as those of an unpaired pilot always are, each plays so
    many episodes of its own, and rows have the mean of their success rates.

    Raises `ConfigurationError`, and `ResultsError` for a folder without results of success.
    """
    if not MIN_DIFFERENCE <= difference < 1:
        smallest = 100 * MIN_DIFFERENCE
        raise ConfigurationError(f"the difference to detect is from {smallest:g} to 100 %, not {100 * difference:g} %")
    if not 0 < power <= MAX_POWER:
        raise ConfigurationError(f"the power is a probability up to {MAX_POWER}, such as 0.8, not {power:.10g}")
    if pairs is not None and not 1 <= pairs <= MAX_PAIRS:
        raise ConfigurationError(f"a comparison has from one to {MAX_PAIRS:,} pairs, not {pairs:,}")
    if pilot is not None:
        plan = _planned(pilot, unpaired)
    else:
        shares = RATES if unpaired else SHARES
        plan = _Planned({Cell(f"{100 * share:g} %"): share for share in shares}, paired=not unpaired)
    tests, num_comparisons = LEVELS * pairs if pairs else plan.tests, pairs or plan.num_comparisons
    impossible = [name for name, share in plan.shares.items() if not plan.is_possible(share, difference)]
    records = [
        {
            "pair": f"{name.text} {name.small}".strip(),
            "discordant" if plan.paired else "success": share,
            COUNTS[0]: None
            if pilot is None and name in impossible
            else episodes_to_detect(difference, share, power, tests, plan.paired),
            COUNTS[1]: episodes_to_show_equivalence(difference, share, power, num_comparisons, plan.paired),
        }
        for name, share in plan.shares.items()
    ]
    rows = [
        [name, *([] if pilot is None else [Cell(f"{100 * share:.1f} %")])]
        + [Cell(f"{n:,}" if n else UNKNOWN) for n in (record[key] for key in COUNTS)]
        for (name, share), record in zip(plan.shares.items(), records, strict=True)
    ]
    points = f"{100 * difference:g} points"
    headings = ["a - b"] * (pilot is not None) + ["won by exactly one" if plan.paired else "mean success"]
    columns = [*map(Column, headings), Column("to detect"), Column("to show equivalence")]
    title = f"Episodes that tell {points} of success, with a power of {100 * power:g} %"
    table = Table("plan", title, columns, rows, records, _caption(tests, num_comparisons, plan.paired))
    return Document(
        [table, *map(Remark, _remarks(plan, difference, bool(impossible), pilot is not None))],
        {"difference": difference, "power": power},
    )


def _remarks(plan: _Planned, difference: float, impossible: bool, has_pilot: bool) -> list[str]:
    """Return what a plan depends on. It is `impossible` for policies of some rows to differ by so much."""
    remarks = ["Play them with another seed, or with the pilot's, which resumes it."]
    if not plan.paired:
        remarks = ["Each policy plays so many episodes. The same ones for both would be fewer: then they are pairs."]
    elif not has_pilot:
        remarks = ["Two policies of 95 and 97 % whose failures are independent differ in 7.7 % of their episodes."]
    if impossible:
        end = ", which is what detecting it is planned for." if has_pilot else "."
        limit = f"differ in at least {100 * difference:g} % of their episodes"
        if not plan.paired:
            limit = f"have a mean success of {50 * difference:g} to {100 - 50 * difference:g} %"
        remarks.append(f"Policies that differ by {100 * difference:g} points {limit}{end}")
    if plan.left_out:
        remarks.append(f"Left out: {', '.join(plan.left_out)}. {TRAININGS}.")
    if plan.paired:
        remarks.append(
            "compare --until decided needs no number: it takes 1 to 1.8 times as many episodes for the same difference "
            "and power, and fewer for a larger difference."
        )
    return remarks


def _caption(tests: int, num_comparisons: int, paired: bool) -> str:
    """Return a caption that states the corrections of the tests."""
    corrections = f"to detect, for {tests} test{'s' * (tests > 1)} of success, steps and return; "
    corrections += f"to show equivalence, for {num_comparisons} pair{'s' * (num_comparisons > 1)}"
    episodes = "the same episodes for both policies" if paired else "different episodes, so many for each policy"
    return f"Tests at 5 % after Bonferroni's correction ({corrections}), on {episodes}."


def _planned(pilot: Path, unpaired: bool) -> _Planned:
    from armctl.study.results import read_comparison  # with tables of episodes, which no other plan needs
    from armctl.verdict.pairs import verdict_pairs

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
    paired = pilot_results.facts.paired and not unpaired
    shares = {name: replace(pair, paired=paired).planning_share for name, pair in policy_pairs.items()}
    pair = verdict_pairs(pilot_results.policies, pilot_results.differences, pilot_results.facts.baseline)[0]
    return _Planned(shares, pair.p.tests, pair.num_comparisons, left_out, paired)

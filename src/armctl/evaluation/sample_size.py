"""How many episodes a comparison needs."""

from pathlib import Path

from armctl.errors import ConfigurationError, ResultsError
from armctl.evaluation.paired import episodes_to_detect, episodes_to_show_equivalence
from armctl.evaluation.results import read_results
from armctl.evaluation.tables import AGAINST, Cell, Column, Document, Remark, Table

SHARES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4)
"""Of episodes that exactly one of two policies wins."""


def plan_comparison(difference: float, power: float = 0.8, pilot: Path | None = None) -> Document:
    """How many episodes tell a difference in success, or that there is none as large.

    `power` is the probability of telling it. With the results folder of a pilot, there is a row for each pair of its
    policies, whose share of discordant episodes is estimated with one more of either kind (Laplace's rule).

    Raises `ConfigurationError`, and `ResultsError` for a folder without results of success.
    """
    if not 0 < difference < 1:
        raise ConfigurationError(f"the difference to detect is between 0 and 100 %, not {100 * difference:g} %")
    if not 0 < power < 1:
        raise ConfigurationError(f"the power is a probability between 0 and 1, such as 0.8, not {power:g}")
    shares = {Cell(f"{100 * share:g} %"): share for share in SHARES} if pilot is None else _shares(pilot)
    records = [
        {
            "pair": f"{name.text} {name.small}".strip(),
            "discordant": share,
            "episodes_to_detect": episodes_to_detect(difference, share, power),
            "episodes_to_show_equivalence": episodes_to_show_equivalence(difference, share, power),
        }
        for name, share in shares.items()
    ]
    rows = [
        [name, *([] if pilot is None else [Cell(f"{100 * share:.1f} %")])]
        + [Cell(f"{record[key]:,}") for key in ("episodes_to_detect", "episodes_to_show_equivalence")]
        for (name, share), record in zip(shares.items(), records, strict=True)
    ]
    points = f"{100 * difference:g} points"
    headings = ["won by exactly one"] if pilot is None else ["a - b", "won by exactly one"]
    columns = [*map(Column, headings), Column("to detect"), Column("to show equivalence")]
    title = f"Episodes that tell {points} of success, with a power of {100 * power:g} %"
    return Document(
        [
            Table("plan", title, columns, rows, records, "Tests at 5 %, on the same episodes for both policies."),
            Remark("Two policies of 95 and 97 % whose failures are independent differ in 7.7 % of their episodes.")
            if pilot is None
            else Remark("Play them with another seed, or with the pilot's, which resumes it."),
        ],
        {"difference": difference, "power": power},
    )


def _shares(pilot: Path) -> dict[Cell, float]:
    paired = read_results(pilot).comparison.paired
    known = [pair for pair in paired if pair.mcnemar_p is not None]
    if not known:
        raise ResultsError(f"{pilot} has no pair of policies whose success is known, and so nothing to plan by")
    return {Cell(pair.a, AGAINST + pair.b): (pair.only_a + pair.only_b + 1) / (pair.episodes + 2) for pair in known}

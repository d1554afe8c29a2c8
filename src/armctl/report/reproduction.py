"""The table of `armctl reproduce`: what agents' cards claim, and what was found."""

from collections.abc import Sequence

from armctl.agents import Evaluation
from armctl.study.reproduce import Reproduction
from armctl.verdict.tables import UNKNOWN, Cell, Column, Document, Remark, Table

COLUMNS = (
    Column("agent"), Column("on the card"), Column("now"), Column("agrees"), Column("episodes", optional=True),
    Column("steps, card", optional=True), Column("steps, now", optional=True),
)  # fmt: skip


def reproduction_document(again: Sequence[Reproduction]) -> Document:
    """Return a row for each agent that was evaluated again."""
    caption = " ".join(dict.fromkeys(_rule(reproduction) for reproduction in again)) + " Steps: to the goal."
    rows = [_row(reproduction) for reproduction in again]
    title = "Success of agents, on their cards and now"
    table = Table("agents", title, COLUMNS, rows, [_record(reproduction) for reproduction in again], caption)
    return Document([table, *(_disagreement(reproduction) for reproduction in again if not reproduction.agrees)])


def _rule(again: Reproduction) -> str:
    if again.same_episodes:
        return "On a card's own episodes, an agent agrees if all of the card's figures are the same."
    return (
        "On other episodes, an agent agrees unless a test is significant at 5 % after Holm's correction: Barnard's "
        "exact test of success, and Welch's tests of return and steps if the card has their standard deviations."
    )


def _disagreement(again: Reproduction) -> Remark:
    differences = "; ".join(map(str, again.differences))
    hint = (
        " Other versions or processors may compute actions that differ in the last digits."
        if again.same_episodes
        and not {"success_rate", "digest"} & {difference.figure for difference in again.differences}
        else ""
    )
    return Remark(f"{again.card.name} does not agree with its card: {differences}.{hint}", "problem")


def _row(again: Reproduction) -> list[Cell]:
    low, high = again.claimed.success_interval
    return [
        Cell(again.card.name),
        Cell(f"{100 * again.claimed.success_rate:.1f} %", f"{100 * low:.1f} to {100 * high:.1f}"),
        Cell(f"{100 * again.measured.success_rate:.1f} %"),
        Cell("yes" if again.agrees else "no"),
        Cell(f"{again.measured.episodes}", f"of seed {again.measured.seed}"),
        _steps(again.claimed),
        _steps(again.measured),
    ]


def _steps(evaluation: Evaluation) -> Cell:
    steps = evaluation.mean_steps_to_goal
    return Cell(UNKNOWN if steps is None else f"{steps:.1f}")


def _record(again: Reproduction) -> dict[str, object]:
    return {
        "agent": again.card.name,
        "env": again.card.env,
        "agrees": again.agrees,
        "differences": [str(difference) for difference in again.differences],
        "card": again.claimed.model_dump(),
        "now": again.measured.model_dump(),
    }

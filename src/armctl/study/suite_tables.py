"""Tables of a suite, from its verdicts."""

from collections.abc import Sequence
from dataclasses import asdict

from armctl.stats.across_tasks import Choice, League
from armctl.study.task_verdict import TaskVerdict, chosen, rule_of_choice
from armctl.verdict.summary_tables import UNCONDITIONAL
from armctl.verdict.tables import UNKNOWN, Cell, Column, Table, p_value, percent


def task_table(verdicts: Sequence[TaskVerdict], extent: str, seed: int, quick: bool) -> Table:
    """Return a table with a row for each task: the policies that represent the two kinds, and their difference."""
    hybrids = any(verdict.hybrid for verdict in verdicts)
    kinds = ["classical", "learned", *["hybrid"] * hybrids]
    columns = [Column(name) for name in ("task", *kinds, "difference")] + [Column("p", optional=True)]
    rows, records = [], []
    for verdict in verdicts:
        head = verdict.undisturbed
        choices: list[Choice | None] = [getattr(verdict, kind) for kind in kinds]
        rows.append(
            [
                Cell(verdict.task),
                *(Cell(percent(verdict.rate(choice)).text, chosen(choice)) if choice else Cell(UNKNOWN)
                  for choice in choices),
                percent(head.difference, "+") if head else Cell(UNKNOWN),
                Cell(p_value(head.p) if head else UNKNOWN),
            ]
        )  # fmt: skip
        records.append(
            {
                "env": verdict.env, "classical": chosen(verdict.classical), "learned": chosen(verdict.learned),
                **({"difference": asdict(head.difference), **asdict(head)} if head else {}),
                "reversals": verdict.reversals,
                "hybrid": chosen(verdict.hybrid), "of_hybrid": verdict.of_hybrid,
            }
        )  # fmt: skip
    interval = "95 % interval at any number of episodes" if stops_early(verdicts) else "MOVER's 95 % interval"
    caption = (
        f"{rule_of_choice(verdicts, quick)} Undisturbed. Difference of classical and learned, with {interval}; "
        f"p: {success_test(verdicts)}, after Holm's correction for all tasks, and for success and steps together."
    )
    title = f"{len(rows)} tasks of seed {seed}: {extent}"
    return Table("tasks", title, columns, rows, records, caption)


def stops_early(verdicts: Sequence[TaskVerdict]) -> bool:
    """Return True if cells stopped when they were decided."""
    return any(pair.anytime is not None for verdict in verdicts if (pair := verdict.undisturbed))


def success_test(verdicts: Sequence[TaskVerdict]) -> str:
    """Return the test of success undisturbed, and on which episodes policies were compared, in words."""
    paired = {pair.wins is None for verdict in verdicts if (pair := verdict.undisturbed)}
    different = f"{UNCONDITIONAL}'s exact test, on different episodes"
    if paired == {False}:
        return different
    if stops_early(verdicts):
        return "a betting test that holds at any number of episodes, on the same episodes"
    return f"McNemar's exact test, on the same episodes{f', or {different}' if False in paired else ''}"


def rank_table(league: League) -> Table:
    """Return a table with a row for each family that has played all tasks of a league."""
    tasks = ", ".join(league.tasks)
    rows = [[Cell(name), percent(mean)] for name, mean in league.ranks.items()]
    records = [{"tasks": tasks, "family": name, "rank": asdict(mean)} for name, mean in league.ranks.items()]
    caption = (
        "Families that have played all of these tasks. Rivals beaten in an episode, ties counting half: the mean over "
        "settings and tasks, with 95 % intervals. The order is that of the means, which need not differ significantly."
    )
    title = f"Ranks of families in {tasks}"
    return Table("ranks", title, [Column("family"), Column("rivals beaten")], rows, records, caption)

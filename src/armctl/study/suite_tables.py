"""The tables of a suite, from its answers."""

from collections.abc import Sequence
from dataclasses import asdict

from armctl.stats.across_tasks import League
from armctl.study.answers import CHOSEN, Answer, chosen
from armctl.verdict.tables import UNKNOWN, Cell, Column, Table, p_value, percent


def task_table(answers: Sequence[Answer], episodes: int, seed: int) -> Table:
    """A row for each task: who stands for the two kinds, and how they differ."""
    columns = [Column("task"), Column("classical"), Column("learned"), Column("difference"), Column("p", optional=True)]
    rows, records = [], []
    for one in answers:
        head = one.undisturbed
        rates = [one.rate(one.classical), one.rate(one.learned)]
        rows.append(
            [
                Cell(one.task),
                *(Cell(percent(rate).text, chosen(choice)) if choice else Cell(UNKNOWN)
                  for rate, choice in zip(rates, (one.classical, one.learned), strict=True)),
                percent(head.difference, "+") if head else Cell(UNKNOWN),
                Cell(p_value(head.p) if head else UNKNOWN),
            ]
        )  # fmt: skip
        records.append(
            {
                "env": one.env, "classical": chosen(one.classical), "learned": chosen(one.learned),
                **({"difference": asdict(head.difference), **asdict(head)} if head else {}), "turns": one.turns,
            }
        )  # fmt: skip
    caption = (
        "The best classical and the best learned policy, undisturbed. "
        "Difference with MOVER's 95 % interval; p: McNemar's exact test, after Holm's "
        f"correction for all tasks, and for success and steps together. {CHOSEN}"
    )
    title = f"{len(rows)} tasks: {episodes} episodes of seed {seed} in each setting"
    return Table("tasks", title, columns, rows, records, caption)


def rank_table(league: League) -> Table:
    """A row for each family that has played all tasks of a league."""
    tasks = ", ".join(league.tasks)
    rows = [[Cell(name), percent(mean)] for name, mean in league.ranks.items()]
    records = [{"tasks": tasks, "family": name, "rank": asdict(mean)} for name, mean in league.ranks.items()]
    caption = (
        "Families that have played all of these tasks. Rivals beaten in an episode, ties counting half: the mean over "
        "settings and tasks, with 95 % intervals. The order is that of the means, which need not differ significantly."
    )
    title = f"Ranks of families in {tasks}"
    return Table("ranks", title, [Column("family"), Column("rivals beaten")], rows, records, caption)

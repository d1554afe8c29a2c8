"""The table of all trained agents, from their cards: `python tools/zoo.py` writes `rl/README.md`.

Shipped agents have their cards in `rl/agents/`, those of other training seeds theirs in `rl/agents/seeds/`; a release
gives them their evaluations on the sealed test (`tools/release.py`). Cards get what the ledger has on the trials of
their recipes.
"""

from itertools import groupby
from pathlib import Path

from armctl.agents import AgentCard, read_card
from armctl.core.files import write_atomically
from armctl.rl.run.lineage import recorded_tuning

HOME = Path(__file__).parents[1] / "rl"
HEAD = """<!-- Made by `python tools/zoo.py` from the agents' cards: change those, or tools/zoo.py. -->
# The zoo: agents that come with armctl

`armctl compare reach_ik NAME` compares an agent with an expert. `armctl train NAME` trains it again by its recipe in
`rl/recipes/`. `armctl reproduce NAME` repeats the evaluation on its card, which uses held-out episodes of the
unmodified task. Decisions are control steps in simulation, by the agent, a teacher or in demonstrations; queries are
actions of a teacher; gradient steps are updates of the network. With teachers: the costs of all networks that an agent
learned from, directly or through its teachers, are added, each once; trials are other trainings of these recipes, and
those of searches, as far as `rl/trials.csv` has them: of trials while the first recipes were being found, it has
nothing. Minutes are wall time on one core of a busy machine,
two or three times those of an idle one; processor minutes are those of all cores. A dash is unknown: these agents are
older than the counters, and only what follows exactly from their options was filled in. Agents in bold come with
armctl: where there are several training seeds, the one with the median success, of two the lower one (of `reach_bc`,
seed 0; its others were trained by a later version). Rows below them are the other seeds: `NAME[*]` is all of them, as
in `moving_dagger[*]`. Success is that of all episodes of the sealed test that a release has played, once, with the
present physics; of an agent that was trained since then, of development episodes, as its card says.

"""
COLUMNS = (
    "agent", "environment", "learner", "shaping", "teacher", "decisions", "with teachers", "queries", "gradient steps",
    "processor minutes", "with teachers", "minutes", "trials", "seed", "success", "95 % interval", "steps to goal",
)  # fmt: skip


def table() -> str:
    """Return all agents as a Markdown table: one row per training seed, the shipped one first."""
    shipped = {path.stem: read_card(path) for path in sorted((HOME / "agents").glob("*.json"))}
    seeds = [
        (path.stem.rpartition("-")[0], read_card(path)) for path in sorted((HOME / "agents" / "seeds").glob("*.json"))
    ]
    by_name = {name: [card for _, card in cards] for name, cards in groupby(seeds, key=lambda pair: pair[0])}
    rows = [COLUMNS, ("---",) * len(COLUMNS)]
    for name, card in sorted(shipped.items(), key=lambda item: (item[1].env, item[0])):
        rows += [_row(f"**`{name}`**", card), *(_row("", other) for other in by_name.get(name, []))]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def write() -> None:
    """Write the table into `rl/README.md`."""
    write_atomically(HOME / "README.md", HEAD + table())


def _row(name: str, card: AgentCard) -> tuple[str, ...]:
    evaluation, total = card.evaluation, card.cost.total
    assert evaluation is not None
    low, high = evaluation.success_interval
    steps = evaluation.mean_steps_to_goal
    return (
        name,
        card.env.removeprefix("armctl/"),
        card.learner,
        card.shaping or "-",
        card.teacher or "-",
        _count(card.decisions),
        _count(total.decisions),
        _count(card.teacher_queries),
        _count(card.gradient_steps),
        _minutes(card.processor_seconds),
        _minutes(total.processor_seconds),
        "-" if card.training_minutes is None else f"{card.training_minutes:.1f}",
        "-" if total.tuning is None else _count(total.tuning.trials),
        "-" if card.training_seed is None else str(card.training_seed),
        f"{evaluation.success_rate:.1%} of {evaluation.episodes:,}",
        f"{low:.1%} to {high:.1%}",
        f"{steps:.1f}" if steps else "-",
    )


def _count(number: int | None) -> str:
    return "-" if number is None else f"{number:,}"


def _minutes(seconds: float | None) -> str:
    return "-" if seconds is None else f"{seconds / 60:.1f}"


def record_tuning() -> None:
    """Write on the cards what is recorded of the trials of their recipes."""
    for path in sorted((HOME / "agents").rglob("*.json")):
        card = read_card(path)
        if card.tuning != (tuning := recorded_tuning(str(card.recipe))):
            write_atomically(path, card.model_copy(update={"tuning": tuning}).model_dump_json(indent=2) + "\n")


if __name__ == "__main__":
    record_tuning()
    write()

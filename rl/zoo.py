"""The table of all trained agents, from their cards: `python -m armctl.rl.zoo` writes `rl/README.md`.

Shipped agents have their cards in `rl/agents/`, those of other training seeds theirs in `rl/agents/seeds/`. With
`--evaluate`, all agents that are there play the test's episodes, and the cards get the results, as after new physics.
With `--recount`, cards that are older than the counters get those costs of their training that are certain.
"""

import sys
from contextlib import closing
from itertools import groupby
from pathlib import Path

from armctl.agents import AgentCard, read_card
from armctl.envs import make_worlds
from armctl.evaluation.reproduce import reproduce
from armctl.evaluation.seeds import TEST_SEED
from armctl.evaluation.trials import TRIALS, read_trials, results_of, write_trials
from armctl.files import write_atomically
from armctl.rl.recount import recount

HOME = Path(__file__).parent
HEAD = """<!-- Made by `python -m armctl.rl.zoo` from the agents' cards: change those, or rl/zoo.py. -->
# The zoo: agents that come with armctl

`armctl compare reach_ik NAME` compares an agent with an expert. `armctl train NAME` trains it again by its recipe in
`rl/recipes/`. `armctl reproduce NAME` repeats the evaluation on its card, which uses held-out episodes of the
unmodified task. Decisions are control steps in simulation, by the agent, a teacher or in demonstrations; queries are
actions of a teacher; gradient steps are updates of the network. Minutes are wall time on one core of a busy machine,
two or three times those of an idle one; processor minutes are those of all cores. A dash is unknown: these agents are
older than the counters, and only what follows exactly from their options was filled in. Agents in bold come with
armctl: where there are several training seeds, the one with the median success, of two the lower one (of `reach_bc`,
seed 0; its others were trained by a later version). Rows below them are the other seeds: `NAME[*]` is all of them, as
in `moving_dagger[*]`. All agents were evaluated with the present physics, on episodes of the test's seed.

"""
COLUMNS = (
    "agent", "environment", "learner", "shaping", "teacher", "decisions", "queries", "gradient steps",
    "processor minutes", "minutes", "seed", "success", "95 % interval", "steps to goal",
)  # fmt: skip


def table() -> str:
    """All agents as a Markdown table: one row per training seed, the shipped one first."""
    shipped = {path.stem: read_card(path) for path in sorted((HOME / "agents").glob("*.json"))}
    others = [
        (path.stem.rpartition("-")[0], read_card(path)) for path in sorted((HOME / "agents" / "seeds").glob("*.json"))
    ]
    by_name = {name: [card for _, card in cards] for name, cards in groupby(others, key=lambda pair: pair[0])}
    rows = [COLUMNS, ("---",) * len(COLUMNS)]
    for name, card in sorted(shipped.items(), key=lambda item: (item[1].env, item[0])):
        rows += [_row(f"**`{name}`**", card), *(_row("", other) for other in by_name.get(name, []))]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def write() -> None:
    """Write the table into `rl/README.md`."""
    write_atomically(HOME / "README.md", HEAD + table())


def _row(name: str, card: AgentCard) -> tuple[str, ...]:
    evaluation = card.evaluation
    assert evaluation is not None
    low, high = evaluation.success_interval
    steps = evaluation.mean_steps_to_goal
    return (
        name,
        card.env.removeprefix("armctl/"),
        card.learner,
        card.shaping or "-",
        card.teacher or "-",
        *(
            "-" if count is None else f"{count:,}"
            for count in (card.decisions, card.teacher_queries, card.gradient_steps)
        ),
        "-" if card.processor_seconds is None else f"{card.processor_seconds / 60:.1f}",
        "-" if card.training_minutes is None else f"{card.training_minutes:.1f}",
        "-" if card.training_seed is None else str(card.training_seed),
        f"{evaluation.success_rate:.1%} of {evaluation.episodes:,}",
        f"{low:.1%} to {high:.1%}",
        f"{steps:.1f}" if steps else "-",
    )


def evaluate() -> None:
    """Evaluate all agents with a graph on the test's episodes; cards and the record of trials get the results."""
    for path in sorted((HOME / "agents").rglob("*.onnx")):
        path = path.with_suffix(".json")
        again = reproduce(path, seed=TEST_SEED)
        print(f"{path.stem}: {again.claimed.success_rate:.1%} -> {again.found.success_rate:.1%}", flush=True)
        card = again.card.model_copy(update={"evaluation": again.found})
        write_atomically(path, card.model_dump_json(indent=2) + "\n")
    record()


def record() -> None:
    """Give the trials of which there are cards the results on these."""
    cards = [read_card(path) for path in (HOME / "agents").rglob("*.json")]
    results = {card.sha256: results_of(card) for card in cards}
    rows = read_trials(HOME / TRIALS)
    write_trials(HOME / TRIALS, [{**row, **results.get(row["sha256"], {})} for row in rows])


def fill_in() -> None:
    """Give the cards what is certain of their costs."""
    for path in (*(HOME / "agents").glob("*.json"), *(HOME / "agents" / "seeds").glob("*.json")):
        card = read_card(path)
        with closing(make_worlds(card.env, 1, card.env_options)) as worlds:
            certain = recount(card, worlds.max_episode_steps or 0)
        write_atomically(path, card.model_copy(update=certain).model_dump_json(indent=2) + "\n")


if __name__ == "__main__":
    if "--evaluate" in sys.argv:
        evaluate()
    if "--recount" in sys.argv:
        fill_in()
    write()

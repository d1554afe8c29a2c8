"""Put trained agents among those that come with armctl: `python -m armctl.rl.publish FOLDER...`.

Folders are those of `armctl train RECIPE --seed S --out FOLDER`, of one recipe. Of all its training seeds, also of
those that are there already, the one with the median success is shipped in `rl/agents/`; the others go to
`rl/agents/seeds/`. Rows of the `trials.csv` beside the folders that `rl/trials.csv` does not have yet are added to it,
also those of failed trainings.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from armctl.agents import AgentCard, read_card, sha256
from armctl.errors import AgentFileError, ConfigurationError
from armctl.evaluation.curves import CURVE
from armctl.evaluation.trials import TRIALS, read_trials, write_trials
from armctl.files import write_atomically
from armctl.learners import recipe_names
from armctl.policies.trainings import check_alike
from armctl.rl import zoo

SUFFIXES = (".onnx", ".csv", ".json")


class TrainedAgent(NamedTuple):
    """An agent's files."""

    path: Path
    """Of its card."""
    card: AgentCard
    graph: bytes
    curve: bytes
    success: float


def publish(folders: Sequence[Path], home: Path = zoo.HOME, *, replace: bool = False) -> Path:
    """Ship the median one of the agents in `folders` and of those in `home`. Returns its card's path.

    Agents in `home` that were trained with other options are in the way, unless they may be replaced.

    Raises `AgentFileError` if a folder has no finished agent, `ConfigurationError` if trainings differ in more than
    their seed or have the same one. Nothing has been changed then.
    """
    new = [_read(folder / "agent.json", folder / CURVE) for folder in folders]
    name = str(new[0].card.recipe)
    if name not in recipe_names():
        raise ConfigurationError(f"{folders[0]} was trained by {name}, which is no recipe of armctl")
    for agent in new:
        check_alike(name, new[0].card, agent.card, agent.path)
    by_seed = {agent.card.training_seed: agent for agent in new}
    if len(by_seed) < len(new):
        raise ConfigurationError(f"of {len(new)} trainings, some have the same seed")
    shipped, seeds = home / "agents" / f"{name}.json", home / "agents" / "seeds"
    cards = [path for path in (shipped, *seeds.glob(f"{name}-[0-9]*.json")) if path.with_suffix(".onnx").exists()]
    if not replace:
        for agent in (_read(path, path.with_suffix(".csv")) for path in cards):
            check_alike(name, new[0].card, agent.card, agent.path)
            by_seed.setdefault(agent.card.training_seed, agent)
    records = _new_trials(folders, home / TRIALS)
    ranked = sorted(by_seed.values(), key=lambda agent: agent.success)
    median = ranked[(len(ranked) - 1) // 2]
    for agent in ranked:
        _write(agent, shipped if agent is median else seeds / f"{name}-{agent.card.training_seed}.json")
    written = {shipped, *(seeds / f"{name}-{agent.card.training_seed}.json" for agent in ranked if agent is not median)}
    for path in set(cards) - written:
        for suffix in SUFFIXES:
            path.with_suffix(suffix).unlink(missing_ok=True)
    write_trials(home / TRIALS, records)
    return shipped


def _read(path: Path, curve: Path) -> TrainedAgent:
    card = read_card(path)
    graph = path.with_suffix(".onnx")
    if card.evaluation is None or not graph.exists() or sha256(graph) != card.sha256:
        raise AgentFileError(f"{path} is not of a finished training, or its network was changed")
    return TrainedAgent(path, card, graph.read_bytes(), curve.read_bytes(), card.evaluation.success_rate)


def _write(agent: TrainedAgent, path: Path) -> None:
    path.with_suffix(".onnx").write_bytes(agent.graph)
    path.with_suffix(".csv").write_bytes(agent.curve)
    card = agent.card.model_copy(update={"name": path.stem})
    write_atomically(path, card.model_dump_json(indent=2) + "\n")


def _new_trials(folders: Sequence[Path], trials: Path) -> list[dict[str, Any]]:
    """All rows of `trials`, and those of the folders' records that are not there yet."""
    rows: list[dict[str, Any]] = list(read_trials(trials))
    for record in sorted({folder.resolve().parent / TRIALS for folder in folders}):
        if record.exists():
            dated = ({**row, "date": row["date"][:10]} for row in read_trials(record))
            rows += [row for row in dated if row not in rows]
    return rows


def main(
    folders: Annotated[list[Path], typer.Argument(metavar="FOLDER...", help="Finished trainings of one recipe.")],
    replace: Annotated[bool, typer.Option("--replace", help="Replace agents trained with other options.")] = False,
) -> None:
    """Put trained agents among those that come with armctl."""
    print(f"shipped: {publish(folders, replace=replace)}")
    zoo.write()


if __name__ == "__main__":
    typer.run(main)

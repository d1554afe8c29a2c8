"""Put trained agents among those that come with armctl: `python tools/publish.py FOLDER...`.

Folders are those of `armctl train RECIPE --seed S --out FOLDER`, of one recipe. Of all its training seeds, also of
those that are there already, the one with the median success in development is shipped in `rl/agents/`; the others go
to `rl/agents/seeds/`. The next release plays the sealed test with all of them (`tools/release.py`). Rows of the
`trials.csv` beside the folders that `rl/trials.csv` does not have yet are added to it, also those of failed trainings.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
import zoo

from armctl.agents import CARD, AgentCard, read_card, sha256
from armctl.core.errors import AgentFileError, ConfigurationError
from armctl.core.files import write_atomically
from armctl.policies.trainings import by_seed
from armctl.study.curves import curve_path
from armctl.training.learners import recipe_names
from armctl.training.trials import TRIALS, read_trials, write_trials


class TrainedAgent(NamedTuple):
    """An agent's files."""

    card: AgentCard
    graph: bytes
    curve: bytes


def publish(folders: Sequence[Path], home: Path = zoo.HOME, *, replace: bool = False) -> Path:
    """Ship the median one of the agents in `folders` and of those in `home`. Returns its card's path.

    Agents in `home` that were trained with other options are in the way, unless they may be replaced.

    Raises `AgentFileError` if a folder has no finished agent, `ConfigurationError` if trainings differ in more than
    their seed or have the same one. Nothing has been changed then.
    """
    name = str(read_card(folders[0] / CARD).recipe)
    if name not in recipe_names():
        raise ConfigurationError(f"{folders[0]} was trained by {name}, which is no recipe of armctl")
    shipped, seeds = home / "agents" / f"{name}.json", home / "agents" / "seeds"
    present = [path for path in (shipped, *seeds.glob(f"{name}-[0-9]*.json")) if path.with_suffix(".onnx").exists()]
    new = by_seed(name, [folder / CARD for folder in folders])
    kept = {} if replace else {seed: path for seed, path in by_seed(name, present).items() if seed not in new}
    agents = [_read(path) for path in by_seed(name, [*new.values(), *kept.values()]).values()]
    trials = _new_trials(folders, home / TRIALS)
    agents.sort(key=lambda agent: agent.card.judgement.success_rate if agent.card.judgement else 0.0)
    median = agents.pop((len(agents) - 1) // 2)
    placed = {shipped: median} | {seeds / f"{name}-{agent.card.training_seed}.json": agent for agent in agents}
    for path, agent in placed.items():
        _write(agent, path)
    for path in set(present) - placed.keys():
        for suffix in (".onnx", ".csv", ".json"):
            path.with_suffix(suffix).unlink(missing_ok=True)
    write_trials(home / TRIALS, trials)
    return shipped


def _read(path: Path) -> TrainedAgent:
    card, graph = read_card(path), path.with_suffix(".onnx")
    if card.evaluation is None or not graph.exists() or sha256(graph) != card.sha256:
        raise AgentFileError(f"{path} is not of a finished training, or its network was changed")
    return TrainedAgent(card, graph.read_bytes(), curve_path(path).read_bytes())


def _write(agent: TrainedAgent, path: Path) -> None:
    path.with_suffix(".onnx").write_bytes(agent.graph)
    path.with_suffix(".csv").write_bytes(agent.curve)
    card = agent.card.model_copy(update={"name": path.stem})
    write_atomically(path, card.model_dump_json(indent=2) + "\n")


def _new_trials(folders: Sequence[Path], trials: Path) -> list[dict[str, Any]]:
    """Return all rows of `trials`, and those of the folders' records that are not there yet."""
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
    zoo.record_tuning()
    zoo.write()


if __name__ == "__main__":
    typer.run(main)

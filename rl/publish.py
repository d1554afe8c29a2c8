"""Put trained agents among those that come with armctl: `python -m armctl.rl.publish FOLDER...`.

Folders are those of `armctl train RECIPE --seed S --out FOLDER`, of one recipe. Of all its training seeds, also of
those that are there already, the one with the median success is shipped in `rl/agents/`; the others go to
`rl/agents/seeds/`. Agents that were there, but were trained with other options, are replaced. Rows of the `trials.csv`
beside the folders that `rl/trials.csv` does not have yet are added to it, also those of failed trainings.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from armctl.agents import AgentCard, read_card
from armctl.errors import ConfigurationError
from armctl.evaluation.curves import CURVE
from armctl.evaluation.trials import TRIALS, add_trial, read_trials
from armctl.rl import zoo

SAME = (
    "recipe", "env", "env_options", "training_options", "reward_weights", "curriculum", "teacher", "learner_options",
)  # fmt: skip
"""What trainings of one recipe have in common on their cards."""


class Training(NamedTuple):
    """An agent's files."""

    card: AgentCard
    graph: bytes
    curve: bytes


def publish(folders: Sequence[Path], home: Path = zoo.HOME) -> Path:
    """Ship the median one of the trainings in `folders` and of those in `home`. Returns its card's path.

    Raises `AgentFileError` if a folder has no finished agent, `ConfigurationError` if they are of several recipes.
    """
    new = [_read(folder / "agent.json", folder / CURVE) for folder in folders]
    for folder, training in zip(folders, new, strict=True):
        if training.card.recipe is None or not _alike(training, new[0]):
            raise ConfigurationError(f"{folder} is not a training of the same recipe as {folders[0]}, or of none")
    name = str(new[0].card.recipe)
    agents, seeds = home / "agents", home / "agents" / "seeds"
    cards = [path for path in (agents / f"{name}.json", *seeds.glob(f"{name}-[0-9]*.json")) if path.exists()]
    old = [_read(path, path.with_suffix(".csv")) for path in cards if path.with_suffix(".onnx").exists()]
    by_seed = {training.card.training_seed: training for training in (*old, *new) if _alike(training, new[0])}
    ranked = sorted(by_seed.values(), key=_success)
    median = ranked[(len(ranked) - 1) // 2]
    for path in cards:
        for suffix in (".json", ".onnx", ".csv"):
            path.with_suffix(suffix).unlink(missing_ok=True)
    for training in ranked:
        seed = training.card.training_seed
        _write(training, agents / f"{name}.json" if training is median else seeds / f"{name}-{seed}.json")
    _record(folders, home / TRIALS)
    return agents / f"{name}.json"


def _read(card: Path, curve: Path) -> Training:
    return Training(read_card(card), card.with_suffix(".onnx").read_bytes(), curve.read_bytes())


def _alike(one: Training, other: Training) -> bool:
    return all(getattr(one.card, field) == getattr(other.card, field) for field in SAME)


def _success(training: Training) -> float:
    evaluation = training.card.evaluation
    return evaluation.success_rate if evaluation else 0.0


def _write(training: Training, path: Path) -> None:
    path.with_suffix(".onnx").write_bytes(training.graph)
    path.with_suffix(".csv").write_bytes(training.curve)
    path.write_text(training.card.model_copy(update={"name": path.stem}).model_dump_json(indent=2) + "\n")


def _record(folders: Sequence[Path], trials: Path) -> None:
    """Add those rows of the folders' records that are not there yet."""
    known = {(row["recipe"], row["seed"], row["steps"], row["sha256"]) for row in read_trials(trials)}
    for record in sorted({folder.resolve().parent / TRIALS for folder in folders}):
        for row in read_trials(record):
            if (row["recipe"], row["seed"], row["steps"], row["sha256"]) not in known:
                add_trial(trials, row | {"date": row["date"][:10]})


if __name__ == "__main__":
    print(f"shipped: {publish([Path(folder) for folder in sys.argv[1:]])}")
    (zoo.HOME / "README.md").write_text(zoo.HEAD + zoo.table())

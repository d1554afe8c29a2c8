"""The trainings of a recipe: `reach_bc[*]` is all of them as one learner, `reach_bc[1]` the one of training seed 1.

They are shipped agents and what is in `seeds/` beside them, or for a path such as `runs/reach_ppo[*]`, what `armctl
train` has written into `runs/reach_ppo-0`, `runs/reach_ppo-1` and so on.
"""

import contextlib
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from armctl.agents import FILES, AgentCard, read_card
from armctl.core.errors import AgentFileError, ConfigurationError
from armctl.core.registration import files_beside

GROUP = "armctl.policies"
SEEDS = "seeds"
"""Folder of further trainings, beside the shipped one: `NAME-SEED.json` and `.onnx`."""
ALIKE = (
    "learner", "recipe", "env", "env_options", "training_options", "shaping", "shaping_scale", "reward_weights",
    "curriculum", "teacher", "interface", "learner_options",
)  # fmt: skip
"""What trainings of one recipe have in common on their cards."""
_NAME = re.compile(r"(?P<recipe>.+)\[(?P<seed>\*|\d{1,18})\]")


def agent_cards() -> dict[str, Path]:
    """The cards of installed agents, by name."""
    return files_beside(GROUP, ".json")


def is_group(name: object) -> bool:
    """Whether this names all trainings of a recipe."""
    return isinstance(name, (str, Path)) and (found := _NAME.fullmatch(str(name))) is not None and found["seed"] == "*"


def training_card(name: str) -> Path | None:
    """The card of the training that `NAME[SEED]` names; None for a name of another form.

    Raises `ConfigurationError` if there is no such training, or for a whole group, and `AgentFileError`.
    """
    found = _NAME.fullmatch(name)
    if found is None:
        return None
    trainings = trainings_of(found["recipe"])
    if found["seed"] == "*":
        raise ConfigurationError(
            f"{name} is {len(trainings)} trainings, which compare and sweep take as one learner; "
            f"{_named(found['recipe'], min(trainings))} is one of them"
        )
    if int(found["seed"]) not in trainings:
        known = ", ".join(_named(found["recipe"], seed) for seed in trainings)
        raise ConfigurationError(f"there is no training {name!r}. Known: {known}")
    return trainings[int(found["seed"])]


def trainings_of(recipe: str) -> dict[int, Path]:
    """The cards of all trainings of a shipped agent's recipe, or of those in folders `recipe-SEED`, by training seed.

    Raises `ConfigurationError` if there are none, or if they differ in more than the seed, and `AgentFileError`.
    """
    shipped = agent_cards().get(recipe)
    if shipped is not None:
        beside = sorted((shipped.parent / SEEDS).glob(f"{recipe}-*.json"))
        paths = [shipped, *(path for path in beside if path.with_suffix(".onnx").exists())]
    else:
        home = Path(recipe)
        own = re.compile(re.escape(home.name) + r"-\d+")
        paths = []
        with contextlib.suppress(OSError, ValueError):  # a name that no file can have
            folders = (one for one in home.parent.glob("*") if own.fullmatch(one.name)) if home.name else ()
            paths = [path for folder in sorted(folders) if (path := folder / "agent.json").is_file()]
    if not paths:
        raise ConfigurationError(
            f"there are no trainings {recipe}[*]: neither is {recipe} a shipped agent, nor are there folders "
            f"{recipe}-0, {recipe}-1 and so on with an agent.json, as armctl train makes them"
        )
    return by_seed(recipe, paths)


def by_seed(recipe: str, paths: Sequence[Path]) -> dict[int, Path]:
    """Cards of a recipe's trainings, by training seed.

    Raises `ConfigurationError` if they differ in more than the seed or have the same one, and `AgentFileError`.
    """
    cards = [read_card(path) for path in paths]
    found: dict[int, Path] = {}
    for path, card in zip(paths, cards, strict=True):
        _check_alike(recipe, cards[0], card, path)
        if card.training_seed is None:
            raise AgentFileError(f"{path} does not say with which seed it was trained, and so is none of {recipe}[*]")
        if card.training_seed in found:
            raise ConfigurationError(
                f"{path} and {found[card.training_seed]} are both of training seed {card.training_seed}: each counts "
                f"once in {recipe}[*]"
            )
        found[card.training_seed] = path
    return dict(sorted(found.items()))


def expanded(policies: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, list[str]]]:
    """Policies by name with the trainings of each group instead of it, and the names of these, by group.

    A recipe with a single training is no group: it stays under that training's name.

    Raises `ConfigurationError` if a training takes part twice, and for a group without trainings.
    """
    players: dict[str, Any] = {}
    groups: dict[str, list[str]] = {}
    for name, given in policies.items():
        members = {name: given}
        if is_group(given):
            recipe = str(given).rpartition("[")[0]
            members = {_named(name.removesuffix("[*]"), seed): _named(recipe, seed) for seed in trainings_of(recipe)}
        if len(members) > 1:
            groups[name] = list(members)
        if twice := players.keys() & members.keys():
            raise ConfigurationError(f"{min(twice)} is named, and is one of a group that is named too: leave one out")
        players |= members
    if any(map(is_group, policies.values())):
        _check_once(players)
    return players, groups


def _check_once(players: Mapping[str, Any]) -> None:
    seen: dict[str, str] = {}
    for name, given in players.items():
        card = card_of(given)
        if card is None:
            continue
        if card.sha256 in seen:
            raise ConfigurationError(
                f"{seen[card.sha256]} and {name} are the same network, which can take part once: leave one of them out"
            )
        seen[card.sha256] = name


def card_of(given: Any) -> AgentCard | None:
    """The card of a policy, if it is a learned agent's name or file. Raises `AgentFileError`."""
    if not isinstance(given, (str, Path)):
        return None
    path = training_card(str(given)) or agent_cards().get(str(given))
    if path is None and Path(given).suffix in FILES and os.path.isfile(given):  # also for a name that no file can have
        path = Path(given).with_suffix(".json")
    return None if path is None else read_card(path)


def _check_alike(recipe: str, first: AgentCard, card: AgentCard, path: Path) -> None:
    for name in ALIKE:
        for what, one, other in _differences(name, getattr(first, name), getattr(card, name)):
            raise ConfigurationError(
                f"{recipe}[*] are trainings that differ only in their seed, and {path} has the {what} {other!r} "
                f"instead of {one!r}"
            )


def _differences(name: str, one: Any, other: Any) -> Iterator[tuple[str, Any, Any]]:
    """What differs between two cards. Options of the learner that only one version of armctl knew do not count."""
    if name == "learner_options":
        one, other = _present_options(one), _present_options(other)
        names = one.keys() & other.keys()
    elif isinstance(one, dict):
        names = one.keys() | other.keys()
    else:
        if one != other:
            yield name, one, other
        return
    yield from ((key, one.get(key), other.get(key)) for key in sorted(names) if one.get(key) != other.get(key))


def _present_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """The options of a learner; on older cards, two of them said which features it sees."""
    if not isinstance(options.get("features"), bool):
        return dict(options)
    features = "invariant" if options.get("turned") else "plain"
    return {**options, "features": features if options["features"] else "none"}


def _named(recipe: str, seed: int) -> str:
    return f"{recipe}[{seed}]"


def learners(names: Sequence[str], groups: Mapping[str, Sequence[str]]) -> list[str]:
    """Names of policies, with each group instead of its members."""
    group_of = {member: group for group, members in groups.items() for member in members}
    return list(dict.fromkeys(group_of.get(name, name) for name in names))

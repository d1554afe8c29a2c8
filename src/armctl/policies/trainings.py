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

from armctl.agents import CARD, FILES, AgentCard, read_card
from armctl.core.errors import AgentFileError, ConfigurationError, unknown_name
from armctl.core.registration import installed
from armctl.policies.names import GROUP, TRAINING, agent_cards, with_agent, without_filter

SEEDS = "seeds"
"""Folder of further trainings, beside the shipped one: `NAME-SEED.json` and `.onnx`."""
FIELDS_THAT_MUST_MATCH = (
    "learner", "recipe", "env", "env_options", "training_options", "shaping", "shaping_scale", "reward_weights",
    "curriculum", "teacher", "filter", "interface", "learner_options",
)  # fmt: skip
"""Fields of their cards in which trainings of one recipe agree."""


def is_seed_group(name: object) -> bool:
    """Return True if this names all trainings of a recipe."""
    return (
        isinstance(name, (str, Path)) and (match := TRAINING.fullmatch(str(name))) is not None and match["seed"] == "*"
    )


def training_card(name: str) -> Path | None:
    """Return the card of the training that `NAME[SEED]` names; None for a name of another form.

    Raises `ConfigurationError` if there is no such training, or for a whole group, and `AgentFileError`.
    """
    match = TRAINING.fullmatch(name)
    if match is None:
        return None
    trainings = trainings_of(match["recipe"])
    if match["seed"] == "*":
        raise ConfigurationError(
            f"{name} is {len(trainings)} trainings, which compare and sweep take as one learner; "
            f"{_named(match['recipe'], min(trainings))} is one of them"
        )
    if int(match["seed"]) not in trainings:
        names = ", ".join(_named(match["recipe"], seed) for seed in trainings)
        raise ConfigurationError(f"there is no training {name!r}. Known: {names}")
    return trainings[int(match["seed"])]


def trainings_of(recipe: str) -> dict[int, Path]:
    """Return the cards of a shipped agent's trainings, or of those in folders `recipe-SEED`, by training seed.

    Raises `ConfigurationError` if there are none, or if they differ in more than the seed, and `AgentFileError`.
    """
    shipped = agent_cards().get(recipe)
    if shipped is not None:
        beside = sorted((shipped.parent / SEEDS).glob(f"{recipe}-*.json"))
        paths = [shipped, *(path for path in beside if path.with_suffix(".onnx").exists())]
    else:
        home = Path(recipe)
        pattern = re.compile(re.escape(home.name) + r"-\d+")
        paths = []
        with contextlib.suppress(OSError, ValueError):  # a name that no file can have
            folders = (path for path in home.parent.glob("*") if pattern.fullmatch(path.name)) if home.name else ()
            paths = [path for folder in sorted(folders) if (path := folder / CARD).is_file()]
    if not paths:
        raise ConfigurationError(
            f"there are no trainings {recipe}[*]: neither is {recipe} a shipped agent, nor are there folders "
            f"{recipe}-0, {recipe}-1 and so on with an agent.json, as armctl train makes them"
        )
    return by_seed(recipe, paths)


def by_seed(recipe: str, paths: Sequence[Path]) -> dict[int, Path]:
    """Return cards of a recipe's trainings, by training seed.

    Raises `ConfigurationError` if they differ in more than the seed or have the same one, and `AgentFileError`.
    """
    cards = [read_card(path) for path in paths]
    paths_by_seed: dict[int, Path] = {}
    for path, card in zip(paths, cards, strict=True):
        _check_same_recipe(recipe, cards[0], card, path)
        if card.training_seed is None:
            raise AgentFileError(f"{path} does not say with which seed it was trained, and so is none of {recipe}[*]")
        if card.training_seed in paths_by_seed:
            raise ConfigurationError(
                f"{path} and {paths_by_seed[card.training_seed]} are both of training seed {card.training_seed}: each "
                f"counts once in {recipe}[*]"
            )
        paths_by_seed[card.training_seed] = path
    return dict(sorted(paths_by_seed.items()))


def expanded(policies: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, list[str]]]:
    """Replace each group by its trainings; return the policies by name, and the names of trainings, by group.

    A recipe with a single training is no group: it stays under that training's name.

    Raises `ConfigurationError` if a training takes part twice, and for a group without trainings.
    """
    players: dict[str, Any] = {}
    groups: dict[str, list[str]] = {}
    for name, policy in policies.items():
        members = {name: policy}
        if is_seed_group(policy):
            recipe = str(policy).rpartition("[")[0]
            members = {_named(name.removesuffix("[*]"), seed): _named(recipe, seed) for seed in trainings_of(recipe)}
        if len(members) > 1:
            groups[name] = list(members)
        if twice := players.keys() & members.keys():
            raise ConfigurationError(f"{min(twice)} is named, and is one of a group that is named too: leave one out")
        players |= members
    if any(map(is_seed_group, policies.values())):
        _check_once(players)
    return players, groups


def _check_once(players: Mapping[str, Any]) -> None:
    names: dict[str, str] = {}
    for name, policy in players.items():
        card = card_of(policy)
        if card is None or without_filter(policy) != policy:
            continue
        if card.sha256 in names:
            raise ConfigurationError(
                f"{names[card.sha256]} and {name} are the same network, which can take part once: leave one of them out"
            )
        names[card.sha256] = name


def card_of(policy: Any) -> AgentCard | None:
    """Return the card of a policy, if it is a learned agent's name or file. Raises `AgentFileError`."""
    if not isinstance(policy, (str, Path)):
        return None
    policy = without_filter(policy)
    path = training_card(str(policy)) or agent_cards().get(str(policy))
    if path is None and Path(policy).suffix in FILES and os.path.isfile(policy):  # also for impossible file names
        path = Path(policy).with_suffix(".json")
    return None if path is None else read_card(path)


def card_path(agent: str | Path) -> Path:
    """Return the path of an agent's card: by its card, graph or folder, an installed agent's name, or `NAME[SEED]`."""
    path = Path(with_agent(str(agent)))
    if path.suffix in FILES:
        return path.with_suffix(".json")
    if (card := training_card(str(agent))) is not None:
        return card
    cards = agent_cards()
    if str(agent) in installed(GROUP).names - cards.keys():
        raise ConfigurationError(
            f"{agent} is not a learned agent: it has no card, and so nothing to reproduce. Agents are "
            f"{', '.join(sorted(cards))}, or path/to/agent.json; armctl compare plays any policy"
        )
    if str(agent) not in cards:
        raise unknown_name("agent", agent, [*cards, "path/to/agent.json"])
    return cards[str(agent)]


def _check_same_recipe(recipe: str, first: AgentCard, card: AgentCard, path: Path) -> None:
    for name in FIELDS_THAT_MUST_MATCH:
        for field, value, other in _differences(name, getattr(first, name), getattr(card, name)):
            raise ConfigurationError(
                f"{recipe}[*] are trainings that differ only in their seed, and {path} has the {field} {other!r} "
                f"instead of {value!r}"
            )


def _differences(name: str, first: Any, second: Any) -> Iterator[tuple[str, Any, Any]]:
    """Yield differences of two cards. Options of the learner that only one version of armctl knew do not count."""
    if name == "learner_options":
        names = first.keys() & second.keys()
    elif isinstance(first, dict):
        names = first.keys() | second.keys()
    else:
        if first != second:
            yield name, first, second
        return
    yield from ((key, first.get(key), second.get(key)) for key in sorted(names) if first.get(key) != second.get(key))


def _named(recipe: str, seed: int) -> str:
    return f"{recipe}[{seed}]"


def learners(names: Sequence[str], groups: Mapping[str, Sequence[str]]) -> list[str]:
    """Return names of policies, with each group instead of its members."""
    group_of = {member: group for group, members in groups.items() for member in members}
    return list(dict.fromkeys(group_of.get(name, name) for name in names))

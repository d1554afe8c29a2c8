"""Identity of a comparison: what determines its episodes. A results folder holds the episodes of one identity only."""

import ast
import functools
import importlib.util
import inspect
import operator
import os
import sys
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import mujoco
import numpy as np
from gymnasium.envs.registration import load_env_creator

from armctl.agents import AgentCard, OnnxPolicy
from armctl.core.errors import ConfigurationError
from armctl.core.files import short_checksum
from armctl.core.registration import import_attribute, import_named, load_installed
from armctl.envs import EpisodeVectorEnv, TaskVectorEnv, ThirdPartyVectorEnv, find_spec
from armctl.policies import GROUP, Policy, configured, policy_names
from armctl.policies.names import without_filter
from armctl.policies.policy import PlaysApart
from armctl.policies.trainings import card_of
from armctl.remote.names import is_remote
from armctl.runtime.fingerprint import UNKNOWN, fingerprint
from armctl.runtime.folder import differences
from armctl.runtime.own_code import file_of, is_core, is_library, is_library_file, is_own
from armctl.runtime.provenance import versions
from armctl.runtime.state_guard import constants

WITHOUT_EFFECT = {"baselines", "cli", "datasets", "models", "report", "rl", "viewer"}
"""Folders of armctl that take no part in an episode, or count by other means."""
LOADED = "loaded"
"""Key of an identity: the files of all modules of one's own that were loaded."""
_first_seen: dict[Path, bytes] = {}
"""Files of modules, as this process has seen them first."""


def identity(
    env: str,
    env_options: Mapping[str, Any],
    seed: int,
    requested: Mapping[str, Any],
    policies: Mapping[str, Policy],
    worlds: EpisodeVectorEnv,
    real_time: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Return everything that determines a comparison's episodes, as JSON values.

    `requested` are the policies as requested, `policies` those made for `worlds`, as far as they play;
    `real_time` is `RealTime.identity`. Agents, code of one's own, objects, files among the options, the compiled MuJoCo
    model with its meshes, and armctl's source count by checksum; so do the task's constants, as they are, and all
    loaded modules of one's own, by their files. Other files that a policy or an environment opens are not known,
    nor what it imports by a computed name while it plays. Of an isolated policy, its own process has imported the code,
    and tells of it.
    """
    isolated = {name: policy.code for name, policy in policies.items() if isinstance(policy, PlaysApart)}
    apart = {name: code for name, code in isolated.items() if code is not None}
    definitions = {name: _definition(policy) for name, policy in requested.items() if name not in apart}
    cards = {name: card for name, policy in policies.items() if (card := _card(requested[name], policy)) is not None}
    of_code = checksums(env, worlds, env_options, definitions.values())
    return {
        "env": env,
        "env_options": {name: _in_words(value) for name, value in env_options.items()},
        "registered": _registration(env),
        "seed": seed,
        "real_time": real_time,
        "policies": list(requested),
        "sees": {name: policy.sees for name, policy in policies.items()},
        **({"isolated": [*isolated]} if isolated else {}),
        "agents": {name: card.sha256 for name, card in cards.items()},
        "interfaces": {name: card.env_options for name, card in cards.items()},
        "objects": {name: fingerprint(requested) for name, requested in definitions.items() if requested is not None}
        | {name: code.objects for name, code in apart.items()},
        "makers": fingerprint([*_makers(env, worlds)]),
        **(
            {"environment": worlds.worlds[0].get_wrapper_attr("identity")}
            if isinstance(worlds, ThirdPartyVectorEnv) and is_remote(env)
            else {}
        ),
        "constants": fingerprint(constants(worlds)),
        "notes": list(worlds.task.notes),
        LOADED: functools.reduce(operator.or_, (code.loaded for code in apart.values()), _loaded()),
        **of_code | {"code": functools.reduce(operator.or_, (code.code for code in apart.values()), of_code["code"])},
        "versions": versions(),
        "source": checksum_of_core(),
    }


def code_of(policy: str) -> tuple[str, dict[str, str], dict[str, str]]:
    """Return the fingerprint of a policy, the checksums of its code, and those of all own modules that are loaded."""
    definition = _definition(policy)
    return fingerprint(definition), checksums_of_code([definition]), _loaded()


def _card(requested: Any, policy: Policy) -> AgentCard | None:
    """Return the card of an agent; None for any other policy."""
    return policy.card if isinstance(policy, OnnxPolicy) else card_of(requested)


def checksums(
    env: str, worlds: EpisodeVectorEnv, env_options: Mapping[str, Any], things: Iterable[Any] = ()
) -> dict[str, Any]:
    """Return checksums of the code of an environment and of other things, of files among its options, and its model."""
    return {
        "code": checksums_of_code([*things, *_makers(env, worlds)]),
        "files": {str(value): short_checksum(Path(value).read_bytes()) for value in _files(env_options.values())},
        "model": _checksum_of_model(worlds),
    }


def reasons_not_to_resume(stored: Mapping[str, Any], local: Mapping[str, Any]) -> list[str]:
    """Return why episodes of a stored identity cannot be continued, in words: a missing checksum, or a difference.

    Modules of one's own that were loaded then count, loaded now or not; modules loaded since then do not.
    """
    fields = [(name, value) for name, value in local.items() if isinstance(value, Mapping)] + [("", local)]
    unknown = [
        f"episodes of {name} cannot be resumed, since it cannot be hashed ({value.removeprefix(UNKNOWN)[:-11]}): use a "
        "module:function"
        for _, values in fields
        for name, value in values.items()
        if isinstance(value, str) and value.startswith(UNKNOWN)
    ]
    loaded = stored.get(LOADED)
    present = {file: _checksum_at(Path(file).resolve()) for file in loaded} if isinstance(loaded, Mapping) else None
    return unknown or differences(stored, {**local, LOADED: present})


def checksums_of_code(things: Iterable[Any]) -> dict[str, str]:
    """Return checksums of the files that define some functions, classes, objects and modules, by file name.

    Files of one's own which these import count too, wherever in the code they do. The core of armctl is left out, and
    so are scripts and notebooks, which may change from run to run: what these define has a `fingerprint`.

    Raises `ConfigurationError` if a file has changed since this process has first seen it.
    """
    modules = [thing if inspect.ismodule(thing) else inspect.getmodule(_code_of(thing)) for thing in things]
    waiting = [file for module in modules if module is not None and _counts(module) and (file := file_of(module))]
    sources: dict[str, list[bytes]] = {}
    visited: set[Path] = set()
    while waiting:
        file = waiting.pop()
        if file in visited:
            continue
        visited.add(file)
        sources.setdefault(file.name, []).append(content := file.read_bytes())
        _check_unchanged(file, content)
        waiting += _imports_of(file, content)
    return {name: short_checksum(b"".join(sorted(parts))) for name, parts in sorted(sources.items())}


def own_modules() -> dict[str, Path]:
    """Return files of all imported modules that belong to no installed package, by name.

    Raises `ConfigurationError` if a file has changed since this process has first seen it.
    """
    files = _own_files()
    for file in files.values():
        _check_unchanged(file, file.read_bytes())
    return files


def _loaded() -> dict[str, str]:
    """Return checksums of the files of one's own loaded modules, by their paths, relative to this folder if in it."""
    files = {str(file): file for file in _own_files().values()}
    folder = os.path.join(Path.cwd(), "")
    return {path.removeprefix(folder): _checksum_at(files[path]) for path in sorted(files)}


def _own_files() -> dict[str, Path]:
    """Return files of all loaded modules of one's own, by the modules' names."""
    others = "__main__", "__mp_main__", "armctl"  # the script, also as multiprocessing calls it
    return {
        name: file
        for name, module in list(sys.modules.items())
        if name.partition(".")[0] not in others
        and not is_library_file(getattr(module, "__file__", None) or "")
        and (file := file_of(module)) is not None
        and not is_library(file)
    }


def _checksum_at(file: Path) -> str:
    """Return the checksum of a resolved file; another text if it is gone or has changed since it was loaded."""
    try:
        content = file.read_bytes()
    except OSError:
        return "gone"
    changed = _first_seen.setdefault(file, content) != content
    return f"changed since it was imported, to {short_checksum(content)}" if changed else short_checksum(content)


def _check_unchanged(file: Path, content: bytes) -> None:
    if _first_seen.setdefault(file, content) != content:
        raise ConfigurationError(f"{file} has changed since Python imported it: start Python again")


def _definition(policy: Any) -> Any:
    """Return what defines a policy: a function, a class or an object; None for a learned agent's file."""
    if not isinstance(policy, (str, Path)):
        return policy
    if is_remote(policy):
        return None
    name = str(without_filter(policy))
    if (configuration := configured(name)) is not None:
        return configuration.make()
    if name in policy_names():
        return load_installed(GROUP, name, "policy")
    return import_attribute(name, "policy") if ":" in name else None


def _makers(env: str, worlds: EpisodeVectorEnv) -> Iterator[Any]:
    """Yield what makes an environment: its task, or its class, wrappers and constructor; and its registering module."""
    module, _, _ = env.rpartition(":")
    if module and not is_remote(env):
        yield import_named(module, env)
    if not isinstance(worlds, ThirdPartyVectorEnv):
        yield type(worlds.task)
        return
    world = worlds.worlds[0]
    while world is not world.unwrapped:
        yield type(world)
        world = world.env  # type: ignore[attr-defined]
    yield type(world)
    if (maker := find_spec(env).entry_point) is not None:
        yield load_env_creator(maker) if isinstance(maker, str) else maker


def _registration(env: str) -> str:
    """Return a checksum of what an environment was registered with. The code of its maker counts by itself."""
    spec = find_spec(env)
    maker = getattr(spec.entry_point, "__qualname__", spec.entry_point)
    return fingerprint((maker, spec.max_episode_steps, spec.kwargs, spec.additional_wrappers))


def _in_words(value: Any) -> str:
    """Return an option's value; a checksum, if it is not made of plain values."""
    return str(value) if _is_plain(value) else fingerprint(value)


def _is_plain(value: Any) -> bool:
    if isinstance(value, Mapping):
        return all(map(_is_plain, (*value, *value.values())))
    if isinstance(value, (list, tuple)):
        return all(map(_is_plain, value))
    return value is None or isinstance(value, (str, bool, int, float, Path))


def _files(options: Iterable[Any]) -> list[Any]:
    return [value for value in options if isinstance(value, (str, Path)) and os.path.isfile(value)]


def _code_of(thing: Any) -> Any:
    code = getattr(thing, "func", thing)  # of a functools.partial
    return code if inspect.isclass(code) or inspect.isroutine(code) else type(code)


def _imports_of(file: Path, content: bytes) -> Iterator[Path]:
    """Yield the files of one's own that a module imports, at its beginning or later."""
    try:
        nodes = list(ast.walk(ast.parse(content)))
    except (SyntaxError, ValueError):  # an extension module, or a file that nothing imports in fact
        return
    for node in nodes:
        match node:
            case ast.Import():
                names, folder = [name.name for name in node.names], file.parent
            case ast.ImportFrom():
                folder = file.parents[max(node.level - 1, 0)]
                names = [node.module or "", *(f"{node.module or ''}.{name.name}".strip(".") for name in node.names)]
            case ast.Call(args=[ast.Constant(value=str(name)), *_]) if _imports_by_name(node.func):
                names, folder = [name], file.parent
            case _:
                continue
        for name in filter(None, names):
            module = sys.modules.get(name) if folder == file.parent else None
            if module is not None and is_own(module) and (path := file_of(module)):
                yield path
            beside = folder.joinpath(*name.split("."))
            if not is_library(beside):
                yield from filter(Path.is_file, (beside.with_suffix(".py"), beside / "__init__.py"))


def _imports_by_name(function: ast.expr) -> bool:
    """Return True if an expression is one of Python's functions that import a module by a text."""
    name = getattr(function, "attr", getattr(function, "id", ""))
    return name in ("import_module", "__import__")


def _counts(module: ModuleType) -> bool:
    return module.__name__ != "__main__" and not is_core(module)


def _checksum_of_model(worlds: EpisodeVectorEnv) -> str | None:
    if not isinstance(worlds, TaskVectorEnv):
        return None
    model = worlds.task.simulation.model
    content = np.empty(mujoco.mj_sizeModel(model), dtype=np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return short_checksum(content.tobytes())


@functools.cache
def checksum_of_core(also: str = "") -> str:
    """Return the checksum of armctl's own files that may take part in an episode, and of those in the folder `also`."""
    package = importlib.util.find_spec("armctl")
    assert package is not None
    files = {
        file.relative_to(root): file
        for root in package.submodule_search_locations or ()
        for file in Path(root).rglob("*.py")
    }
    taking_part = [name for name in sorted(files) if name.parts[0] not in WITHOUT_EFFECT - {also}]
    return short_checksum(b"".join(files[name].read_bytes() for name in taking_part))

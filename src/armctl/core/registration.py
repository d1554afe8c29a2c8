"""Registration of tasks as environments, and code by its name. Light: it loads Gymnasium and tasks on use only.

Code is named by the person at the keyboard or offered by an installed package, never named by a file.

A package offers its tasks under the entry-point group `armctl.tasks`: a module that registers them when it is imported.
"""

import contextlib
import functools
import importlib
import importlib.util
import shlex
import sys
import warnings
import zlib
from collections.abc import Iterator
from importlib.machinery import ModuleSpec
from importlib.metadata import EntryPoint, EntryPoints, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from armctl.core.errors import FAILURES, ConfigurationError, described, missing_extra, unknown_name

GROUP, PACKAGE = "armctl.tasks", "armctl."
ENV, VECTOR_ENV = "armctl.envs:TaskEnv", "armctl.envs:TaskVectorEnv"
_named: set[str] = set()
"""Names that the user has used in this process, such as `mine.py:pd`. A file can name no other code."""


def register(env_id: str, task: "str | type[Any]", *, max_episode_steps: int | None, **options: Any) -> None:
    """Make a task an environment of Gymnasium's, for `gym.make`, `gym.make_vec` and every verb of armctl.

    Args:
        env_id: any id that Gymnasium takes, such as `mine/Hover-v0`.
        task: subclass of `armctl.tasks.Task`, or `module:Class`, which is imported when the environment is made.
        max_episode_steps: control steps until an episode is truncated; None: never.
        **options: values of the task's options that differ from its defaults.

    """
    import gymnasium

    gymnasium.register(
        id=env_id,
        entry_point=ENV,
        vector_entry_point=VECTOR_ENV,
        max_episode_steps=max_episode_steps,
        kwargs={"task": task, **options},
    )


def bare_id(env: str) -> str:
    """Return an environment's id without the module that registers it: `mine/Hover-v0` of `hover:mine/Hover-v0`."""
    return env.rpartition(":")[2]


def short_name(env: str) -> str:
    """Return an environment's name without that of armctl's package, or of a module."""
    return bare_id(env).removeprefix("armctl/")


def environment_names() -> list[str]:
    """Return ids of all environments that were made of tasks."""
    import gymnasium

    return sorted(env_id for env_id, spec in gymnasium.registry.items() if spec.vector_entry_point == VECTOR_ENV)


def register_installed() -> None:
    """Register the tasks of all installed packages. One that fails is left out, with a warning."""
    for entry in installed(GROUP):
        try:
            entry.load()
        except FAILURES as error:
            warnings.warn(f"the tasks of {entry.value} were left out: {type(error).__name__}: {error}", stacklevel=2)


@functools.cache
def installed(group: str) -> EntryPoints:
    """Return what all installed packages offer under an entry-point group. No other package replaces armctl's own."""
    return EntryPoints(sorted(entry_points(group=group), key=lambda entry: not entry.value.startswith(PACKAGE)))


def load_installed(group: str, name: str, kind: str, extra_for: str = "") -> Any:
    """Return what is installed under a name in an entry-point group; messages call it a `kind`.

    `extra_for` is what armctl's own needs the extra `rl` for. Raises `ConfigurationError`, whatever its module raises.
    """
    entries = installed(group)
    if name not in entries.names:
        raise unknown_name(kind, name, entries.names)
    try:
        return entries[name].load()
    except ConfigurationError:
        raise
    except FAILURES as error:
        if extra_for and isinstance(error, ModuleNotFoundError) and entries[name].value.startswith(PACKAGE):
            raise missing_extra(extra_for, error) from error
        raise ConfigurationError(f"cannot load the {kind} {name}: {described(error)}") from error


def module_spec(entry: EntryPoint) -> ModuleSpec | None:
    """Return where the module of an entry point is, without importing it; None: nowhere, or its package is broken."""
    try:
        return importlib.util.find_spec(entry.module)
    except FAILURES:  # of the packages above it, which are imported
        return None


@functools.cache
def files_beside(group: str, suffix: str) -> dict[str, Path]:
    """Return files `NAME` + `suffix` beside the modules of what is installed in a group, by name. Imports no module."""
    homes = {entry.name: module_spec(entry) for entry in installed(group)}
    files = {name: Path(home.origin).with_name(name + suffix) for name, home in homes.items() if home and home.origin}
    return {name: file for name, file in files.items() if file.exists()}


def files_within(group: str, suffix: str) -> dict[str, Path]:
    """Return files `NAME` + `suffix` in the packages that are installed in a group, by name. Imports no package."""
    homes = [home for entry in installed(group) if (home := module_spec(entry))]
    folders = [Path(folder) for home in homes for folder in home.submodule_search_locations or ()]
    return {file.stem: file for folder in reversed(folders) for file in folder.glob(f"*{suffix}")}


def load_task(task: "str | type[Any]") -> type[Any]:
    """Return the registered task class, imported if it was registered by name; raises `ConfigurationError`."""
    return import_attribute(task, "task") if isinstance(task, str) else task


def import_attribute(name: str, kind: str) -> Any:
    """Return what `module:attribute` or `path/to/module.py:attribute` names; raises `ConfigurationError`."""
    module, _, attribute = name.rpartition(":")
    loaded = import_named(module, f"the {kind} {name!r}")
    if not hasattr(loaded, attribute):
        raise unknown_name(f"{kind} in {module}:", attribute, own_names(loaded))
    remember_named(name)
    return getattr(loaded, attribute)


def own_names(module: ModuleType) -> list[str]:
    """Return what a module defines itself."""
    return [name for name, value in vars(module).items() if getattr(value, "__module__", None) == module.__name__]


def import_named(module: str, purpose: str) -> ModuleType:
    """Import a module that the user has named, by its name or its file's path, from the working directory too.

    Raises `ConfigurationError`, whatever the module raises.
    """
    try:
        return _import_file(Path(module)) if module.endswith(".py") else _import_from(Path.cwd(), module)
    except FAILURES as error:
        raise ConfigurationError(f"cannot load {purpose}: {described(error)}") from error


def remember_named(*names: str) -> None:
    """Remember what the user has named, so that files can name it, too."""
    _named.update(names)


def was_named(name: str) -> bool:
    """Return True if the user has named this in this process."""
    return name in _named


def check_named(name: str, source: str, option: str) -> None:
    """Check a name that stands in a file: if it is code (`module:name`), the user must have named just this.

    `source` is the file, `option` where the user can name the code. Raises `ConfigurationError`.
    """
    if ":" in name and not was_named(name):
        raise ConfigurationError(
            f"{source} names the code {name}, and a file never runs code: if you trust it, name it yourself, {option} "
            f"{shlex.quote(name)}"
        )


@contextlib.contextmanager
def importable_from(folder: Path) -> Iterator[None]:
    """Let modules be imported from a folder, after all other places; a console script does not look where it runs."""
    place = str(folder)
    if place in sys.path:
        yield
        return
    sys.path.append(place)
    try:
        yield
    finally:
        sys.path.remove(place)


def _import_from(folder: Path, module: str) -> ModuleType:
    with importable_from(folder):
        return importlib.import_module(module)


def _import_file(path: Path) -> ModuleType:
    """Import a file, once: by its name, in its package if any, or a longer one if another module has that."""
    path = path.resolve()
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    parts, home = [path.stem], path.parent
    while (home / "__init__.py").is_file():
        parts, home = [home.name, *parts], home.parent
    with importable_from(home):
        module = ".".join(parts).removesuffix(".__init__")
        spec = importlib.util.find_spec(module) if all(part.isidentifier() for part in parts) else None
        if spec is not None and spec.origin == str(path):
            return importlib.import_module(module)
        name = f"{path.stem}_{zlib.crc32(bytes(path)):08x}"
        if name not in sys.modules:
            spec = importlib.util.spec_from_file_location(name, path)
            assert spec is not None
            assert spec.loader is not None
            sys.modules[name] = importlib.util.module_from_spec(spec)
            try:
                spec.loader.exec_module(sys.modules[name])
            except BaseException:
                del sys.modules[name]
                raise
        return sys.modules[name]

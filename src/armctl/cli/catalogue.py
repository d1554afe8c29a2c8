"""The verb that lists everything installed, or everything about one environment: `list`."""

import inspect
import math
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armctl.cli.app import app
from armctl.cli.completion import environments
from armctl.core.errors import ConfigurationError

if TYPE_CHECKING:
    import gymnasium
    from rich.table import Table
    from rich.text import Text


@app.command("list")
def list_(
    env: Annotated[
        str | None,
        typer.Option("--env", metavar="ID", help="Show all about this environment.", autocompletion=environments),
    ] = None,
) -> None:
    """List the environments, policies, arms, disturbances, learners and recipes.

    With `--env ID`: what an environment's observations and actions are, its options with their units and defaults, its
    disturbances with their levels, its potentials for reward shaping, and its default line-up.
    """
    from armctl.report.terminal import output_console

    output_console().print(_everything() if env is None else _environment(env), highlight=False)


def _everything() -> "Table":
    from armctl.core.registration import environment_names
    from armctl.envs import SEES, task_of
    from armctl.policies import declared_sees, describe_policy, policy_names
    from armctl.robot_description import BUILTIN_ARMS
    from armctl.training.learners import learner_names, load_recipe, recipe_names

    table = _grid()
    for kind, names in (("environments", environment_names()), ("arms", BUILTIN_ARMS), ("learners", learner_names())):
        table.add_row(_bold(kind), "  ".join(names))
    policies = ((name, f"{describe_policy(name)} Sees: {SEES[declared_sees(name)]}.") for name in policy_names())
    _add_rows(table, "policies", policies)
    recipes = []
    for recipe in map(load_recipe, recipe_names()):
        guidance = " ".join(f"{name} {value}" for name in ("shaping", "teacher") if (value := getattr(recipe, name)))
        recipes.append((recipe.name, f"{recipe.learner} in {recipe.env} {guidance}"))
    _add_rows(table, "recipes", recipes)
    by_specs: dict[int, tuple[Mapping[str, Any], list[str]]] = {}
    for env in environment_names():
        try:
            specs = task_of(env).disturbances
        except (ConfigurationError, AttributeError) as error:
            table.add_row("", f"{env} cannot be loaded: {error}")
            continue
        by_specs.setdefault(id(specs), (specs, []))[1].append(env)
    for specs, envs in by_specs.values():
        table.add_row(_bold("disturbances"), f"in {', '.join(envs)}:")
        _add_rows(table, "", _disturbances(specs))
    table.add_row(
        "",
        "A policy may also be path/to/agent.json or file.py:NAME, an environment Pendulum-v1 or file.py:NAME, "
        "and an arm path/to/your.urdf.",
    )
    table.add_row("", "`armctl list --env ID` shows an environment's options, observations and actions.")
    return table


def _environment(env: str) -> "Table":
    from contextlib import closing

    from armctl.disturbances import available
    from armctl.envs import ThirdPartyVectorEnv, full_id, make_worlds, task_of
    from armctl.envs.describe import describe_options

    kind: Any = task_of(env)
    table = _grid()
    with closing(make_worlds(env, 1)) as worlds:
        worlds.reset(seed=0)
        task: Any = worlds.task
        period = "unknown" if task.control_period is None else f"{task.control_period:g} s"
        described = kind if not isinstance(worlds, ThirdPartyVectorEnv) else type(worlds.worlds[0].unwrapped)
        _add_rows(table, "environment", [(full_id(env), _first_line(described))])
        _add_rows(table, "control period", [("", period)])
        _add_rows(table, "observation", _observation(worlds.single_observation_space, task))
        _add_rows(table, "action", [("", _action(worlds.single_action_space))])
        if hasattr(kind, "outcomes"):
            wins = [outcome.label + (" (success)" if outcome.success else "") for outcome in kind.outcomes]
            table.add_row(_bold("outcomes"), ", ".join(wins))
        disturbances = _disturbances(available(kind.disturbances, task))
    options = (
        (f"{option.name} = {option.default}", f"{option.type}. {option.text}") for option in describe_options(env)
    )
    _add_rows(table, "options (--set)", options)
    _add_rows(table, "disturbances", disturbances)
    potentials: Mapping[str, Any] = getattr(kind, "potentials", {})
    _add_rows(table, "potentials", ((name, _first_line(potential)) for name, potential in potentials.items()))
    table.add_row(_bold("line-up"), ", ".join(kind.default_policies))
    return table


def _grid() -> "Table":
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    table.add_column()
    table.add_column(overflow="fold")
    return table


def _add_rows(table: "Table", heading: str, rows: Iterable[tuple[str, str]]) -> None:
    """Rows of a name and what it is, of which the first has a heading."""
    from rich.text import Text

    for i, (name, text) in enumerate(rows):
        table.add_row(_bold("" if i else heading), Text.assemble((name, "bold"), "  " if name else "", text))


def _bold(heading: str) -> "Text":
    from rich.text import Text

    return Text(heading, "bold")


def _disturbances(specs: Mapping[str, Any]) -> list[tuple[str, str]]:
    return [
        (name, f"{spec.does} ({spec.unit}): {', '.join(f'{level:g}' for level in spec.levels)}")
        for name, spec in specs.items()
    ]


def _first_line(described: Any) -> str:
    lines = inspect.cleandoc(described.__doc__ or "").split("\n")
    return next((line for line in lines if line.strip() and not line.startswith("#")), "")


def _observation(space: "gymnasium.Space[Any]", task: Any) -> list[tuple[str, str]]:
    """Return the arrays of an observation, or the parts of the one array."""
    if hasattr(space, "spaces"):
        return _leaves(space)
    parts = {name: value.shape[1:] for name, value in task.observation_parts().items()}
    if sum(map(math.prod, parts.values())) == math.prod(space.shape or ()):
        return [(name, _size(shape)) for name, shape in parts.items()]
    return [("", str(space))]


def _leaves(space: "gymnasium.Space[Any]", name: str = "") -> list[tuple[str, str]]:
    """Return the arrays of a space, by names such as `camera/depth`."""
    inner = getattr(space, "spaces", None)
    if inner is None:
        described = str(space) if space.shape is None else f"{_size(space.shape)}, {space.dtype}"
        return [(name, described)]
    named = inner.items() if hasattr(inner, "items") else enumerate(inner)
    return [leaf for key, part in named for leaf in _leaves(part, f"{name}/{key}".removeprefix("/"))]


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape)) if shape else "1"


def _action(space: "gymnasium.Space[Any]") -> str:
    """Size and range of an action."""
    low, high = getattr(space, "low", None), getattr(space, "high", None)
    if low is None or high is None:
        return str(space)
    same = low.min() == low.max() and high.min() == high.max()
    ranges = zip(low.flat, high.flat, strict=True)
    bounds = f"{low.min():g} to {high.max():g}" if same else ", ".join(f"{a:.4g} to {b:.4g}" for a, b in ranges)
    return f"{_size(space.shape or ())} numbers: {bounds}"

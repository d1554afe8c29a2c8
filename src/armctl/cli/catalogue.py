"""The verb that lists everything installed, or everything about one environment: `list`."""

import inspect
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armctl.cli.app import command
from armctl.cli.completion import environments, policies, robots
from armctl.cli.options import checked_env
from armctl.core.errors import ConfigurationError

if TYPE_CHECKING:
    import gymnasium
    from gymnasium.envs.registration import EnvSpec
    from rich.console import RenderableType
    from rich.table import Table
    from rich.text import Text

    from armctl.envs.describe import OptionDescription
    from armctl.policies.catalogue import ListedPolicy


@command("list")
def list_(
    env: Annotated[
        str | None,
        typer.Option(
            "--env",
            metavar="ID",
            help="Show all about this environment.",
            autocompletion=environments,
            callback=checked_env,
        ),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option("--robot", metavar="ROBOT", help="Show all about this robot.", autocompletion=robots),
    ] = None,
    tip: Annotated[str | None, typer.Option("--tip", metavar="LINK", help="End-effector of the robot's file.")] = None,
    policy: Annotated[
        str | None,
        typer.Option("--policy", metavar="NAME", help="Show all about this policy.", autocompletion=policies),
    ] = None,
) -> None:
    """List the tasks with their policies: expert or agent, what each sees, and what it controls.

    With `--env ID`: an environment's observations and actions with their units, the policies that fit, its options with
    their units and defaults, its disturbances with their levels, and its potentials for reward shaping.

    With `--robot ROBOT`, a name or the path of a file (URDF, xacro, MJCF): its joints with their limits, its home, and
    notes about all that was repaired, left out or assumed.

    With `--policy NAME`: what an installed policy is made for, sees and controls, and its options with their defaults
    and the ranges in which `armctl tune` looks for better ones.
    """
    from armctl.report.terminal import output_console

    console, parts = output_console(), [] if env is None else [*_environment(env)]
    if robot is not None:
        parts += _robot(robot, tip)
    if policy is not None:
        parts += _policy(policy)
    for part in parts or _everything():
        console.print(part, highlight=False)


def _everything() -> Iterable["RenderableType"]:
    from armctl.core.registration import environment_names
    from armctl.envs.find import find_spec
    from armctl.policies.catalogue import listed_policies, policies_of, task_values
    from armctl.robot_description.builtin import BUILTIN_ARMS
    from armctl.training.learners import learner_names, readable_recipes

    policies, recipes = listed_policies(), readable_recipes()
    for env in environment_names():
        spec = find_spec(env)
        try:
            values = task_values(spec)
        except ConfigurationError as error:
            yield _pair(env, f"cannot be loaded: {error}")
            continue
        yield _pair(env, values.get("instruction", ""))
        yield _policy_table(spec, policies_of(spec, policies), values.get("default_policies", ()))
        if names := [recipe.name for recipe in recipes if recipe.env == env]:
            yield _grid_of([("  recipes", ", ".join(names))])
        yield ""
    yield "* plays in armctl compare --env ID, where no policies are named."
    yield _grid_of(
        [
            ("robots", f"{', '.join(BUILTIN_ARMS)}; or the path of your arm's URDF, xacro or MJCF file"),
            ("learners", ", ".join(learner_names())),
            ("yours", "policies: agent.json, its folder, file.py:NAME; environments: file.py:NAME"),
            ("more", "armctl list --env ID: options, observations, actions, disturbances"),
        ]
    )


def _policy_table(spec: "EnvSpec", policies: "Sequence[ListedPolicy]", line_up: Sequence[str]) -> "Table":
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from armctl.policies.catalogue import privilege_in

    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False, pad_edge=False)
    for heading in ("  policy", "kind", "sees", "controls"):
        table.add_column(heading)
    for policy in policies:
        mark = "*" if policy.name in line_up else " "
        table.add_row(f"{mark} {policy.name}", policy.kind, privilege_in(spec, policy), policy.controls)
    return table


def _environment(env: str) -> Iterable["RenderableType"]:
    from contextlib import closing

    from armctl.disturbances import available
    from armctl.envs import ThirdPartyVectorEnv, full_id, make_worlds, task_of
    from armctl.envs.describe import describe_general_options, describe_options
    from armctl.envs.find import find_spec
    from armctl.policies.catalogue import listed_policies, policies_of

    kind: Any = task_of(env)
    policies = policies_of(find_spec(env), listed_policies())
    table = _grid()
    with closing(make_worlds(env, 1)) as worlds:
        worlds.reset(seed=0)
        task: Any = worlds.task
        period = "unknown" if task.control_period is None else f"{task.control_period:g} s"
        is_foreign = isinstance(worlds, ThirdPartyVectorEnv)
        described = type(worlds.worlds[0].unwrapped) if isinstance(worlds, ThirdPartyVectorEnv) else kind
        table.add_row(_bold("environment"), full_id(env))
        table.add_row("", task.instruction or _first_line(described))
        table.add_row(_bold("control step"), period)
        _add_rows(table, "observation", _observation(worlds.single_observation_space, task))
        _add_rows(table, "action", [("", _action(worlds.single_action_space, task))])
        if hasattr(kind, "outcomes"):
            possible = getattr(kind, "possible_outcomes", kind.outcomes)
            wins = [outcome.label + (" (success)" if outcome.success else "") for outcome in possible]
            table.add_row(_bold("outcomes"), ", ".join(wins))
        disturbances = _disturbances(available(kind.disturbances, task))
    _add_rows(table, "policies", ((policy.name, policy.summary) for policy in policies))
    table.add_row(_bold("line-up"), ", ".join(kind.default_policies))
    _add_rows(table, "options", _options(describe_options(env)))
    if not is_foreign:
        _add_rows(table, "of every task", _options(describe_general_options()))
    _add_rows(table, "disturbances", disturbances)
    potentials: Mapping[str, Any] = getattr(kind, "potentials", {})
    _add_rows(table, "potentials", ((name, _first_line(potential)) for name, potential in potentials.items()))
    yield table
    yield "Set an option by --set NAME=VALUE, a disturbance by --disturbance NAME=LEVELS in armctl sweep."


def _robot(robot: str, tip: str | None) -> Iterable["RenderableType"]:
    import warnings

    from armctl.robot_description import load_arm

    with warnings.catch_warnings(action="ignore"):  # the notes are shown below
        arm = load_arm(robot, tip=tip)
    limits = arm.limits
    rows = zip(arm.joints, limits.lower, limits.upper, limits.velocity, limits.effort, arm.home, strict=True)
    table = _grid()
    table.add_row(_bold("robot"), arm.name)
    table.add_row(_bold("end-effector"), arm.tip)
    joints = (
        (name, f"{low:.4g} to {high:.4g} {unit}, {speed:.4g} {unit}/s, {effort:.4g} {torque}, home {home:.4g}")
        for name, low, high, speed, effort, home in rows
        for unit, torque in [("m", "N") if name in arm.sliding else ("rad", "N m")]
    )
    _add_rows(table, "joints", joints)
    _add_rows(table, "notes", (("", note) for note in arm.notes or ("none",)))
    yield table


def _policy(name: str) -> Iterable["RenderableType"]:
    from rich.syntax import Syntax

    from armctl.core.errors import unknown_name
    from armctl.core.foresight import FORESIGHT
    from armctl.policies import configurations
    from armctl.policies.catalogue import listed_policies

    policies = {policy.name: policy for policy in listed_policies()}
    if name not in policies:
        raise unknown_name("policy", name, policies)
    policy, file = policies[name], configurations().get(name)
    sees = " + ".join([policy.sees, *(FORESIGHT[future] for future in policy.foresight)])
    rows = [("policy", name), ("", policy.summary), ("kind", policy.kind), ("made for", policy.envs), ("sees", sees)]
    yield _grid_of([*rows, ("controls", policy.controls), ("options", "none" if file is None else "")])
    if file is not None:
        yield Syntax(file.read_text("utf-8").rstrip(), "toml", theme="ansi_light", background_color="default")
        yield f"Change some by name, armctl compare {name} {name}:OPTION=VALUE, or save this as a file and name that."


def _options(described: "Iterable[OptionDescription]") -> Iterator[tuple[str, str]]:
    return ((f"{option.name} = {option.default}", f"{option.type}. {option.text}") for option in described)


def _pair(name: str, text: str) -> "Text":
    from rich.text import Text

    return Text.assemble((name, "bold"), "  ", text)


def _grid() -> "Table":
    from rich.table import Table

    table = Table.grid(padding=(0, 2))
    table.add_column()
    table.add_column()
    return table


def _grid_of(rows: Iterable[tuple[str, str]]) -> "Table":
    table = _grid()
    for heading, text in rows:
        table.add_row(_bold(heading), text)
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
        units = getattr(task, "units", {})
        return [(name, f"{text} {units.get(name, '')}".rstrip()) for name, text in _leaves(space)]
    parts = {name: value.shape[1:] for name, value in task.observation_parts().items()}
    if sum(map(math.prod, parts.values())) == math.prod(space.shape or ()):
        units = getattr(task, "units", {})
        return [(name, f"{_size(shape)} {units.get(name, '')}".rstrip()) for name, shape in parts.items()]
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


def _action(space: "gymnasium.Space[Any]", task: Any) -> str:
    """Size, range and units of an action."""
    units = getattr(task, "units", {})
    meaning = units.get(task.interface.get("control", "action"), "")
    low, high = getattr(space, "low", None), getattr(space, "high", None)
    if low is None or high is None:
        return str(space)
    same = low.min() == low.max() and high.min() == high.max()
    ranges = zip(low.flat, high.flat, strict=True)
    bounds = f"{low.min():g} to {high.max():g}" if same else ", ".join(f"{a:.4g} to {b:.4g}" for a, b in ranges)
    number = math.prod(space.shape or ())
    return f"{number} number{'s' * (number != 1)}{' of ' * bool(meaning)}{meaning}: {bounds}"

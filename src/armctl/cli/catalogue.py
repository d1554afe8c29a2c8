"""The verb that lists everything installed: `list`."""

from collections.abc import Mapping
from typing import Any

from armctl.cli.app import app
from armctl.errors import ConfigurationError


@app.command("list")
def list_() -> None:
    """List the environments, policies, arms, disturbances, learners and recipes."""
    from rich.console import Console
    from rich.table import Table

    from armctl.envs import task_of
    from armctl.learners import learner_names, load_recipe, recipe_names
    from armctl.policies import describe_policy, policy_names
    from armctl.registration import environment_names
    from armctl.robot_description import BUILTIN_ARMS

    table = Table.grid(padding=(0, 2))
    for kind, names in (("environments", environment_names()), ("arms", BUILTIN_ARMS), ("learners", learner_names())):
        table.add_row(f"[bold]{kind}[/]", "  ".join(names))
    for i, name in enumerate(policy_names()):
        table.add_row("" if i else "[bold]policies[/]", f"[bold]{name}[/]  {describe_policy(name)}")
    for i, recipe in enumerate(map(load_recipe, recipe_names())):
        guidance = " ".join(f"{name} {value}" for name in ("shaping", "teacher") if (value := getattr(recipe, name)))
        table.add_row(
            "" if i else "[bold]recipes[/]", f"[bold]{recipe.name}[/]  {recipe.learner} in {recipe.env} {guidance}"
        )
    by_specs: dict[int, tuple[Mapping[str, Any], list[str]]] = {}
    for env in environment_names():
        try:
            specs = task_of(env).disturbances
        except (ConfigurationError, AttributeError) as error:
            table.add_row("", f"{env} cannot be loaded: {error}")
            continue
        by_specs.setdefault(id(specs), (specs, []))[1].append(env)
    for specs, envs in by_specs.values():
        table.add_row("[bold]disturbances[/]", f"in {', '.join(envs)}:")
        for name, spec in specs.items():
            levels = ", ".join(f"{level:g}" for level in spec.levels)
            table.add_row("", f"[bold]{name}[/]  {spec.does} ({spec.unit}): {levels}")
    table.add_row("", "A policy may also be path/to/agent.json or module:function, and an arm path/to/your.urdf.")
    Console(highlight=False).print(table)

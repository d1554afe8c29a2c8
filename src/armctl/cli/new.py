"""The verb that writes files to begin with: `new`."""

import string
from enum import StrEnum
from importlib import resources
from pathlib import Path
from typing import Annotated

import typer

from armctl.cli.app import command
from armctl.core.errors import ConfigurationError, os_errors_as


class Kind(StrEnum):
    """Kinds of files."""

    TASK = "task"


@command()
def new(
    kind: Annotated[Kind, typer.Argument(help="What to write: `task`.")],
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name in small letters, such as `push_box`.")],
) -> None:
    """Write a file to begin with: `armctl new task push_box` writes `push_box.py`, a task that runs.

    It has a world, options, outcomes, rewards, an expert and the registration, with all imports: change one after the
    other to yours.
    """
    from armctl.core.console import PlainConsole

    if not name.isidentifier() or name != name.lower():
        raise ConfigurationError(f"a task's name has small letters, digits and _, such as push_box, not {name!r}")
    file, title = Path(f"{name}.py"), "".join(word.capitalize() for word in name.split("_"))
    template = string.Template(resources.files("armctl.cli").joinpath(f"{kind}_template.txt").read_text())
    with os_errors_as(f"{file} cannot be written", ConfigurationError), file.open("x") as text:
        text.write(template.substitute(name=name, Name=title))
    PlainConsole().print(
        f"{file} is a task that runs: armctl compare --env {file}:mine/{title}-v0 --episodes 20", soft_wrap=True
    )

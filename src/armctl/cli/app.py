"""The command line's application, to which each verb adds itself."""

import functools
import inspect
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields
from typing import Annotated, Any, TypeVar

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup

from armctl import __version__
from armctl.cli.standard_output import TABLE, standard_output

TYPES = {"int range": "N", "int": "N", "float": "X", "float range": "X", "path": "PATH", "str": "TEXT"}
"""Short names of types."""


class _ShortTypes:
    """Help in which flags have no type and others a short one, so that lines have room for what they say."""

    def get_params(self, ctx: Any) -> Any:
        params = super().get_params(ctx)  # type: ignore[misc]  # of Typer's classes
        for param in params:
            if getattr(param, "is_flag", False):
                param.metavar = ""
            elif param.metavar is None and not isinstance(param, TyperArgument):
                param.metavar = TYPES.get(param.display_type(ctx).strip("<>"))
        return params


class _Command(_ShortTypes, TyperCommand):
    pass


class _Group(_ShortTypes, TyperGroup):
    pass


app = typer.Typer(
    cls=_Group,
    help="Compare planners and controllers with learned agents, on the same robot episodes.\n\n"
    "Start with `armctl compare`: an IK expert, a trained PPO agent and a random policy play the same 200 reach "
    "episodes. With `--env armctl/BridgeCross-v0`, a path planner and a camera agent cross the same bridges. "
    "`armctl list` shows all environments, policies and more.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)

Request = TypeVar("Request")


@dataclass
class Settings:
    """Settings that hold for all verbs."""

    traceback: bool = False


settings = Settings()


def _show_version(requested: bool) -> None:
    if requested:
        from importlib.metadata import version
        from platform import python_version

        print(f"armctl {__version__}, MuJoCo {version('mujoco')}, Python {python_version()}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version, and exit.")
    ] = False,
    traceback: Annotated[
        bool, typer.Option("--traceback", help="Show where errors come from; can stand anywhere on the line.")
    ] = False,
) -> None:
    settings.traceback = traceback


def command(name: str | None = None) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Add a function to the command line, whose parameters are options."""
    return app.command(name, cls=_Command)


def verb(function: Callable[[Request], None]) -> Callable[[Request], None]:
    """Add a verb to the command line: a function of a request, a dataclass whose fields are the verb's options.

    A field's type is Annotated with its `typer.Option` or `typer.Argument`; the function's docstring is the help text.
    What a request inherits comes after its own options.
    """
    (request,) = (kind for name, kind in inspect.get_annotations(function).items() if name != "return")

    order = [name for kind in request.__mro__ for name in vars(kind).get("__annotations__", ())]

    @functools.wraps(function)
    def command(**options: Any) -> None:
        with standard_output(options.get("table_format", TABLE)):
            function(request(**options))

    command.__signature__ = inspect.Signature(  # type: ignore[attr-defined]  # which Typer reads
        [
            inspect.Parameter(
                field.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if field.default is MISSING else field.default,
                annotation=field.type,
            )
            for field in sorted(fields(request), key=lambda field: order.index(field.name))
        ]
    )
    app.command(cls=_Command)(command)
    return function

"""Options of verbs that compare: how an environment that is not made of a task is scored."""

from typing import Annotated

import typer

SuccessReturn = Annotated[
    float | None,
    typer.Option(
        "--success-return",
        metavar="RETURN",
        help="Least return of a success, in an environment that is not made of a task.",
        show_default="success is what info tells",
    ),
]
Success = Annotated[
    str | None,
    typer.Option(
        "--success",
        metavar="last|any|return",
        help="Success of an episode in an environment that is not made of a task: what `info` tells in its last step, "
        "or in any, or a return of at least `--success-return`.",
        show_default="last, or return with --success-return",
    ),
]
SuccessKey = Annotated[
    str | None,
    typer.Option(
        "--success-key",
        metavar="KEY",
        help="Key of `info` that tells of success, in an environment that is not made of a task.",
        show_default="is_success, or else success",
    ),
]
ReturnBounds = Annotated[
    tuple[float, float] | None,
    typer.Option(
        "--return-bounds",
        metavar="LOW HIGH",
        help="Least and largest possible return of any episode, for an environment that does not tell them. Means of "
        "returns have intervals and tests with such bounds only.",
        show_default="those of the task, if known",
    ),
]

"""The command line's application, to which each verb adds itself."""

import typer

app = typer.Typer(
    help="Compare planners and controllers with learned agents, on the same robot episodes.\n\n"
    "Start with `armctl compare`: an IK expert, a trained PPO agent and a random policy play the same 200 reach "
    "episodes. With `--env armctl/BridgeCross-v0`, a path planner and a camera agent cross the same bridges. "
    "`armctl list` shows all environments, policies and more.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)

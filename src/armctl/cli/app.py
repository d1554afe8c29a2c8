"""The command line's application, to which each verb adds itself."""

import typer

app = typer.Typer(
    help="Planners and controllers against learned agents, on the same robot episodes.\n\n"
    "Start with `armctl compare`: an IK expert, a trained PPO agent and random actions meet the same 200 reach "
    "episodes. With `--env armctl/BridgeCross-v0`, a path planner and a camera agent cross the same bridges. "
    "`armctl list` shows what else there is.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
)

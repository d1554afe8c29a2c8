"""The verb that makes agents of others' models: `export`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from armctl.cli.app import verb
from armctl.cli.learn import say, words
from armctl.cli.options import EnvOptions, Robot, checked_env, environment_options


@dataclass(frozen=True)
class ExportRequest:
    """Options of `export`."""

    model: Annotated[Path, typer.Argument(help="Model that Stable-Baselines3 or sb3-contrib saved: a file .zip.")]
    env: Annotated[str, typer.Option("--env", help="Environment that the model was trained in.", callback=checked_env)]
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.onnx", help="Agent to write; its card is beside it.", show_default="the model's name"
        ),
    ] = None
    robot: Robot = None
    env_options: EnvOptions = None
    normalisation: Annotated[
        Path | None,
        typer.Option(
            "--vecnormalize",
            metavar="FILE",
            help="Statistics of the observations, saved by VecNormalize; or `none`.",
            show_default="vecnormalize.pkl or vec_normalize.pkl beside the model, if there is one",
        ),
    ] = None
    algorithm: Annotated[
        str | None, typer.Option(help="Such as `ppo`, `sac` or `recurrent_ppo`.", show_default="as the model tells")
    ] = None
    trust: Annotated[bool, typer.Option("--trust", help="Load the model, although its pickles can run any code.")] = (
        False
    )
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an agent of that name.")] = False


@verb
def export(request: ExportRequest) -> None:
    """Convert a model into an agent: Stable-Baselines3 (A2C, DDPG, DQN, PPO, RecurrentPPO, SAC, TD3, TQC).

    `armctl export model.zip --env Pendulum-v1 --out agent.onnx --trust` writes `agent.onnx`, a graph that acts as
    `model.predict(observation, deterministic=True)` does, and `agent.json`, its card. The graph holds the statistics
    of `VecNormalize`: it takes the observations of the environment as they are. `--set` gives the environment the
    options that the training had.

    Before anything is written, both act on 1,000 observations of the environment, and must agree.

    A model's file is a set of pickles, and whoever made it can make them run any code when they are loaded. So it is
    only loaded with `--trust`. The agent that comes out cannot run code, and is safe to share. Needs the extra `rl`.
    """
    from armctl.core.options import option_arguments
    from armctl.training.learners import ModelExport, load_exporter

    model, env = request.model, request.env
    target = request.out or model.with_suffix(".onnx")
    card = load_exporter(model)(
        ModelExport(
            model,
            env,
            target,
            environment_options(request.env, request.env_options, robot=request.robot),
            request.normalisation,
            request.algorithm,
            request.trust,
            request.overwrite,
        )
    )
    conversion = card.conversion
    assert conversion is not None
    statistics = conversion.normalisation
    say(
        f"{model} is a model of {card.learner.removeprefix('sb3-')} after {card.training_steps:,} steps; its "
        + (f"observations are normalised by {statistics}" if statistics else "observations are not normalised")
    )
    say(
        f"Agent and model act alike on {conversion.observations:,} observations of {env}: "
        f"largest difference {conversion.largest_difference:.1g}"
    )
    run = words("armctl", "run", target, "--env", env, *option_arguments(card.env_options))
    say(f"The agent is {target}, with its card beside it: {run}")

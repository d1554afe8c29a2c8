"""Verbs that make agents: `train`, and `export` for models of Stable-Baselines3."""

import functools
import logging
import os
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from armctl.cli import completion
from armctl.cli.app import app
from armctl.cli.options import EnvOptions, options_of
from armctl.errors import ConfigurationError, ResultsError


@app.command()
def train(
    recipe: Annotated[
        str,
        typer.Argument(
            help="Recipe: a name (`armctl list` shows them), path/to/recipe.toml, or a learner's name.",
            autocompletion=completion.recipes,
        ),
    ],
    env: Annotated[
        str | None, typer.Option("--env", help="Environment to train in.", show_default="the recipe's")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of the training.", show_default="the recipe's first")
    ] = None,
    steps: Annotated[int | None, typer.Option(min=1, help="Environment steps.", show_default="the recipe's")] = None,
    shaping: Annotated[
        str | None,
        typer.Option(
            metavar="POTENTIAL",
            help="Potential of the environment's task for reward shaping, such as `distance` or `ik`; or `none`.",
            show_default="the recipe's",
        ),
    ] = None,
    shaping_scale: Annotated[
        float | None, typer.Option(help="Reward per unit of the potential.", show_default="the recipe's")
    ] = None,
    teacher: Annotated[
        str | None, typer.Option(metavar="POLICY", help="Policy to learn from.", show_default="the recipe's")
    ] = None,
    options: Annotated[
        list[str] | None,
        typer.Option("--option", metavar="NAME=VALUE", help="Option of the learner, such as `--option gamma=0.98`."),
    ] = None,
    env_options: EnvOptions = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the agent, logs and checkpoints.", show_default="runs/<recipe>-<seed>"),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Resume from the newest checkpoint in the folder. Checkpoints can run code: only of your own.",
        ),
    ] = False,
    track: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TRACKER",
            help="Record options, learning curve, video and agent in an experiment tracker: `wandb`, `mlflow` (extras "
            "of the same names) or `tensorboard`; repeatable.",
            autocompletion=completion.trackers,
        ),
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(
            min=1, help="Threads of physics and network: 1 for trainings beside each other.", show_default="all cores"
        ),
    ] = None,
) -> None:
    """Train an agent by a recipe; needs the extra `rl`.

    The extra: `pip install 'armctl-suite[rl]'`, or `pip install -e '.[rl]'` in a clone.

    `armctl train reach_ppo` repeats the training of the shipped agent. Everything in a recipe can be changed:
    `armctl train reach_ppo --seed 1 --shaping ik --set robot=ur10 --option worlds=64`, or
    `armctl train ppo --env armctl/BridgeCross-v0`. A recipe's file never runs code: name an environment or a teacher of
    your own with `--env` or `--teacher`, even if the recipe names it too.

    During training, the agent is evaluated on held-out episodes (`curve.csv`), and the best version is kept. Ctrl-C
    leaves a checkpoint, and the same command with `--resume` resumes from it. Checkpoints are pickles, which can run
    any code when they are loaded: resume only trainings of your own. Each training, also one that fails, gets a row in
    `trials.csv` beside its folder.

    Watch the training with `tensorboard --logdir FOLDER`, or let `--track wandb` or `--track mlflow` record it where
    you keep your experiments. A tracker that fails does not harm the training, and `--resume` continues the same run.
    """
    from armctl.envs import task_of
    from armctl.evaluation.trials import TRIALS, add_trial, progress_of, results_of, trial
    from armctl.learners import load_learner, load_recipe
    from armctl.options import option_arguments
    from armctl.simulation.threads import LIMIT
    from armctl.tracking import tracked

    if threads:
        os.environ[LIMIT] = str(threads)
    chosen = load_recipe(recipe, env, teacher)
    given = {"shaping": shaping, "shaping_scale": shaping_scale}
    changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if shaping == "none":
        changes["shaping"] = None
    learner_options = options_of(options, "--option") | ({} if steps is None else {"steps": steps})
    chosen = chosen.changed(
        **changes,
        options=chosen.options | learner_options,
        env_options=chosen.env_options | options_of(env_options),
    )
    seed = chosen.seeds[0] if seed is None else seed
    folder = out or Path("runs") / f"{chosen.name}-{seed}"
    if resume and (folder / "settings.json").exists():
        _say(f"Resuming {folder}. Its checkpoints are pickles, which can run code: go on only if it is your own.", True)
    changed = given | {"options": learner_options, "env_options": options_of(env_options), "teacher": teacher}
    started = trial(chosen.name, chosen.learner, chosen.env, seed, changed, "finished")

    def record(ended: str, why: str, results: dict[str, Any]) -> None:
        add_trial(folder.parent / TRIALS, started | {"ended": ended, "note": why} | results)

    try:
        tell = functools.partial(_say, error=True)
        with _evaluations_logged(), tracked(track or (), chosen, folder, seed, resume, tell):
            card = load_learner(chosen.learner)(chosen, out=folder, seed=seed, resume=resume)
    except KeyboardInterrupt:
        begun = (folder / "settings.json").exists()
        if begun:
            record("interrupted", "", progress_of(folder))
        how = f"with --resume {_words('--out', folder)} resumes the training" if begun else "starts it again"
        _say(f"Interrupted. The same command {how}.")
        raise typer.Exit(130) from None
    except ConfigurationError:  # it was refused, and is no training
        raise
    except Exception as error:
        if (folder / "settings.json").exists():
            try:
                record("failed", str(error), progress_of(folder))
            except ResultsError as untold:
                error.add_note(str(untold))
        raise
    record("finished", "", results_of(card))
    assert card.evaluation is not None
    low, high = card.evaluation.success_interval
    _say(
        f"Trained for {card.cost}, in {card.training_minutes} minutes; best after {card.best_after:,} steps: "
        f"success {card.evaluation.success_rate:.1%} [{low:.1%}, {high:.1%}] "
        f"on {card.evaluation.episodes} held-out episodes"
    )
    rival, agent = task_of(chosen.env).default_policies[0], folder / "agent.json"
    environment = ("--env", chosen.env, *option_arguments(chosen.env_options))
    _say(f"The agent is {agent}: {_words('armctl', 'compare', rival, agent, *environment)}")


@app.command()
def export(
    model: Annotated[Path, typer.Argument(help="Model that Stable-Baselines3 or sb3-contrib saved: a file .zip.")],
    env: Annotated[str, typer.Option("--env", help="Environment that the model was trained in.")],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.onnx", help="Agent to write; its card is beside it.", show_default="the model's name"
        ),
    ] = None,
    env_options: EnvOptions = None,
    normalisation: Annotated[
        Path | None,
        typer.Option(
            "--vecnormalize",
            metavar="FILE",
            help="Statistics of the observations, saved by VecNormalize; or `none`.",
            show_default="vecnormalize.pkl or vec_normalize.pkl beside the model, if there is one",
        ),
    ] = None,
    algorithm: Annotated[
        str | None, typer.Option(help="Such as `ppo`, `sac` or `recurrent_ppo`.", show_default="as the model tells")
    ] = None,
    trust: Annotated[
        bool, typer.Option("--trust", help="Load the model, although its pickles can run any code.")
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace an agent of that name.")] = False,
) -> None:
    """Make an agent of a model of Stable-Baselines3 (A2C, DDPG, DQN, PPO, RecurrentPPO, SAC, TD3, TQC).

    `armctl export model.zip --env Pendulum-v1 --out agent.onnx --trust` writes `agent.onnx`, a graph that acts as
    `model.predict(observation, deterministic=True)` does, and `agent.json`, its card. The graph holds the statistics
    of `VecNormalize`: it takes the observations of the environment as they are. `--set` gives the environment the
    options that the training had.

    Before anything is written, both act on 1,000 observations of the environment, and must agree.

    A model's file is a set of pickles, and whoever made it can make them run any code when they are loaded. So it is
    only loaded with `--trust`. The agent that comes out cannot run code, and is safe to share. Needs the extra `rl`.
    """
    from armctl.learners import load_exporter
    from armctl.options import option_arguments

    target = out or model.with_suffix(".onnx")
    card = load_exporter(model)(
        model,
        env=env,
        out=target,
        env_options=options_of(env_options),
        normalisation=normalisation,
        algorithm=algorithm,
        trust=trust,
        overwrite=overwrite,
    )
    conversion = card.conversion
    assert conversion is not None
    statistics = conversion.normalisation
    _say(
        f"{model} is a model of {card.learner.removeprefix('sb3-')} after {card.training_steps:,} steps; its "
        + (f"observations are normalised by {statistics}" if statistics else "observations are not normalised")
    )
    _say(
        f"Agent and model act alike on {conversion.observations:,} observations of {env}: "
        f"largest difference {conversion.largest_difference:.1g}"
    )
    run = _words("armctl", "run", target, "--env", env, *option_arguments(card.env_options))
    _say(f"The agent is {target}, with its card beside it: {run}")


@contextmanager
def _evaluations_logged() -> Iterator[None]:
    """Print a line after each evaluation where there is no terminal for a progress bar."""
    if sys.stdout.isatty() and sys.stderr.isatty():
        yield
        return
    log, lines = logging.getLogger("armctl"), logging.StreamHandler(sys.stdout)
    before = log.level
    log.addHandler(lines)
    log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.setLevel(before)
        log.removeHandler(lines)


def _say(text: str, error: bool = False) -> None:
    from armctl.console import printable

    typer.echo(printable(text), err=error)


def _words(*words: object) -> str:
    """A command's words as a shell takes them."""
    return shlex.join(str(word) for word in words)

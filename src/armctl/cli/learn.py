"""The verb that makes agents: `train`."""

import functools
import logging
import os
import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from armctl.cli import completion
from armctl.cli.app import verb
from armctl.cli.options import EnvOptions, On, Robot, checked_env, environment_options, options_of, progress_bar
from armctl.core.errors import ConfigurationError

if TYPE_CHECKING:
    from armctl.agents import AgentCard
    from armctl.training.learners import Recipe
    from armctl.training.run import TrainingJob


@dataclass(frozen=True)
class TrainRequest:
    """Options of `train`."""

    recipe: Annotated[
        str,
        typer.Argument(
            help="Recipe: a name (`armctl list` shows them), path/to/recipe.toml, or a learner's name.",
            autocompletion=completion.recipes,
        ),
    ]
    env: Annotated[
        str | None,
        typer.Option(
            "--env",
            help="Environment to train in.",
            show_default="the recipe's",
            autocompletion=completion.environments,
            callback=checked_env,
        ),
    ] = None
    seed: Annotated[
        str | None,
        typer.Option(
            metavar="SEEDS",
            help="Seed of the training, several such as `0,1,2`, or `all` of the recipe's.",
            show_default="the recipe's first",
        ),
    ] = None
    steps: Annotated[int | None, typer.Option(min=1, help="Environment steps.", show_default="the recipe's")] = None
    shaping: Annotated[
        str | None,
        typer.Option(
            metavar="POTENTIAL",
            help="Potential of the environment's task for reward shaping, such as `distance` or `ik`; or `none`.",
            show_default="the recipe's",
        ),
    ] = None
    shaping_scale: Annotated[
        float | None, typer.Option(help="Reward per unit of the potential.", show_default="the recipe's")
    ] = None
    teacher: Annotated[
        str | None, typer.Option(metavar="POLICY", help="Policy to learn from.", show_default="the recipe's")
    ] = None
    filter: Annotated[
        bool,
        typer.Option(
            "--filter", help="Let a safety filter change actions in training after which a contact is certain."
        ),
    ] = False
    options: Annotated[
        list[str] | None,
        typer.Option("--option", metavar="NAME=VALUE", help="Option of the learner, such as `--option gamma=0.98`."),
    ] = None
    robot: Robot = None
    env_options: EnvOptions = None
    out: Annotated[
        Path | None,
        typer.Option(
            help="Folder for the agent, logs and checkpoints; with several seeds, the beginning of their names.",
            show_default="runs/<recipe>-<seed>",
        ),
    ] = None
    resume: Annotated[
        bool,
        typer.Option(
            "--resume",
            help="Resume from the newest checkpoint in the folder. Checkpoints can run code: only of your own.",
        ),
    ] = False
    track: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TRACKER",
            help="Record options, learning curve, video and agent in an experiment tracker: `wandb`, `mlflow` (extras "
            "of the same names) or `tensorboard`; repeatable.",
            autocompletion=completion.trackers,
        ),
    ] = None
    threads: Annotated[
        int | None,
        typer.Option(
            min=1, help="Threads of physics and network: 1 for trainings beside each other.", show_default="all cores"
        ),
    ] = None
    workers: Annotated[
        int, typer.Option(min=1, help="Trainings that run at once, each with its seed and on one core.")
    ] = 1
    on: On = "local"


@verb
def train(request: TrainRequest) -> None:
    """Train an agent by a recipe; needs the extra `rl`.

    The extra: `pip install 'armctl-suite[rl]'`, or `pip install -e '.[rl]'` in a clone.

    `armctl train reach_ppo` repeats the training of the shipped agent. Everything in a recipe can be changed:
    `armctl train reach_ppo --seed 1 --shaping ik --set robot=ur10 --option worlds=64`, or
    `armctl train ppo --env armctl/BridgeCross-v0`. A recipe's file never runs code: name an environment or a teacher of
    your own with `--env` or `--teacher`, even if the recipe names it too.

    `armctl train reach_ppo --seed all --workers 3` trains with each of the recipe's seeds; with `--on`, on a cluster.

    During training, the agent is evaluated on held-out episodes (`curve.csv`), and the best version is kept. Ctrl-C
    leaves a checkpoint, and the same command with `--resume` resumes from it. Checkpoints are pickles, which can run
    any code when they are loaded: resume only trainings of your own. Each training, also one that fails, gets a row in
    `trials.csv` beside its folder.

    Watch the training with `tensorboard --logdir FOLDER`, or let `--track wandb` or `--track mlflow` record it where
    you keep your experiments. A tracker that fails does not harm the training, and `--resume` continues the same run.
    """
    from armctl.simulation.threads import THREADS_ENV_VAR

    if request.threads:
        os.environ[THREADS_ENV_VAR] = str(request.threads)
    job = _training_job(request)
    seeds = _seeds(request.seed, job.recipe.seeds)
    start = Path("runs") / job.recipe.name
    if len(seeds) == 1 and request.on == "local":
        _train_one(job, seeds[0], request.out or _of_seed(start, seeds[0]), request.track or ())
        return
    if request.track:
        raise ConfigurationError("a tracker follows one training in this process: leave out --track, or give one seed")
    folders = {seed: _of_seed(request.out or start, seed) for seed in seeds}
    _train_several(job, folders, request.on, request.workers)


def _of_seed(folder: Path, seed: int) -> Path:
    return folder.with_name(f"{folder.name}-{seed}")


def _training_job(request: TrainRequest) -> "TrainingJob":
    """Return the recipe with what the command line changes."""
    from armctl.training.learners import load_recipe

    recipe = load_recipe(request.recipe, request.env, request.teacher)
    shaping = {"shaping": request.shaping, "shaping_scale": request.shaping_scale}
    changes: dict[str, Any] = {name: value for name, value in shaping.items() if value is not None}
    if request.shaping == "none":
        changes["shaping"] = None
    if request.filter:
        changes["filter"] = True
    learner_options = options_of(request.options, "--option") | (
        {} if request.steps is None else {"steps": request.steps}
    )
    env_options = environment_options(recipe.env, request.env_options, robot=request.robot)
    recipe = recipe.changed(
        **changes, options=recipe.options | learner_options, env_options=recipe.env_options | env_options
    )
    from armctl.training.run import TrainingJob  # after all that can be misspelt

    differences = shaping | {"options": learner_options, "env_options": env_options, "teacher": request.teacher}
    differences |= {"filter": True} if request.filter else {}
    return TrainingJob(recipe, differences, request.resume)


def _train_one(job: "TrainingJob", seed: int, folder: Path, trackers: Sequence[str]) -> None:
    """Train with one seed in this process, and say how the agent does."""
    from armctl.agents import CARD
    from armctl.integrations.tracking import tracked
    from armctl.training.learners import load_learner
    from armctl.training.run import SETTINGS, log_trial

    recipe, resume = job.recipe, job.resume
    if resume and (folder / SETTINGS).exists():
        say(f"Resuming {folder}. Its checkpoints are pickles, which can run code: go on only if it is your own.", True)
    try:
        tell = functools.partial(say, error=True)
        with (
            log_trial(job, seed, folder),
            _evaluations_logged(),
            tracked(trackers, recipe, folder, seed, resume, tell) as on_evaluation,
        ):
            learner = load_learner(recipe.learner)
            card = learner(recipe, out=folder, seed=seed, resume=resume, on_evaluation=on_evaluation)
    except KeyboardInterrupt:
        has_begun = (folder / SETTINGS).exists()
        how = f"with --resume {words('--out', folder)} resumes the training" if has_begun else "starts it again"
        say(f"Interrupted. The same command {how}.")
        raise typer.Exit(130) from None
    agent = folder / CARD
    say(_result(card, recipe.options.get("steps")))
    say(f"The agent is {agent}: {_comparison(recipe, agent)}")


def _train_several(job: "TrainingJob", folders: dict[int, Path], on: str, workers: int) -> None:
    """Train with several seeds, and say how each training has ended."""
    from armctl.runtime.engines import connect
    from armctl.training.run import train_seeds

    failed = 0
    try:
        with connect(on, workers) as engine, progress_bar() as bar:
            task = bar.add_task("trainings", total=len(folders))
            for outcome in train_seeds(job, folders, engine):
                bar.advance(task)
                failed += outcome.failure is not None
                requested, card = job.recipe.options.get("steps"), outcome.card
                say(f"Seed {outcome.seed}: {_result(card, requested) if card else f'failed: {outcome.failure}'}")
    except KeyboardInterrupt:
        say("Interrupted. The same command with --resume resumes the trainings.")
        raise typer.Exit(130) from None
    if failed:
        raise ConfigurationError(f"{failed} of {len(folders)} trainings failed")
    group = next(iter(folders.values()))
    seeds = f"{group.with_name(group.name.rpartition('-')[0])}[*]"
    say(f"All of them as one learner: {_comparison(job.recipe, seeds)}")


def _comparison(recipe: "Recipe", agent: Path | str) -> str:
    """Return the command that compares an agent with the task's first expert."""
    from armctl.core.options import option_arguments
    from armctl.envs import task_of

    rival = task_of(recipe.env).default_policies[0]
    return words("armctl", "compare", rival, agent, "--env", recipe.env, *option_arguments(recipe.env_options))


def _result(card: "AgentCard", requested: int | None) -> str:
    """Return what a training cost and how its agent does, and whether it was longer than requested."""
    assert card.evaluation is not None
    low, high = card.evaluation.success_interval
    longer = requested is not None and card.training_steps > requested
    return (
        f"{card.training_steps:,} steps were made, not {requested}: {card.learner} makes whole rollouts. "
        * longer
        + f"Trained for {card.cost}, in {card.training_minutes} minutes; best after {card.best_after:,} steps: "
        f"success {card.evaluation.success_rate:.1%} [{low:.1%}, {high:.1%}] "
        f"on {card.evaluation.episodes} development episodes"
    )


def _seeds(text: str | None, all_of_them: list[int]) -> list[int]:
    """Training seeds from what was asked for. Raises `ConfigurationError`."""
    if text is None:
        return all_of_them[:1]
    if text == "all":
        return all_of_them
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isascii() and part.isdecimal() for part in parts):
        raise ConfigurationError(f"--seed takes whole numbers from 0 on, such as 0 or 0,1,2, or `all`, not {text!r}")
    if len(set(seeds := [int(part) for part in parts])) < len(seeds):
        raise ConfigurationError(f"--seed names a seed twice: {text}")
    return seeds


@contextmanager
def _evaluations_logged() -> Iterator[None]:
    """Print a line after each evaluation where there is no terminal for a progress bar."""
    if sys.stdout.isatty() and sys.stderr.isatty():
        yield
        return
    log, lines = logging.getLogger("armctl"), logging.StreamHandler(sys.stdout)
    previous_level = log.level
    log.addHandler(lines)
    log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.setLevel(previous_level)
        log.removeHandler(lines)


def say(text: str, error: bool = False) -> None:
    """Say something in a line."""
    from armctl.core.console import printable

    typer.echo(printable(text), err=error)


def words(*words: object) -> str:
    """Return a command's words as a shell takes them."""
    return shlex.join(str(word) for word in words)

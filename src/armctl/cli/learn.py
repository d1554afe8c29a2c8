"""The verb that trains: `train`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from armctl.cli.app import app
from armctl.cli.options import EnvOptions, options_of


@app.command()
def train(
    recipe: Annotated[
        str,
        typer.Argument(help="Recipe: a name (`armctl list` shows them), path/to/recipe.toml, or a learner's name."),
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
    resume: Annotated[bool, typer.Option("--resume", help="Resume from the newest checkpoint in the folder.")] = False,
) -> None:
    """Train an agent by a recipe; needs the extra `rl`.

    The extra: `pip install 'armctl-suite[rl]'`, or `pip install -e '.[rl]'` in a clone.

    `armctl train reach_ppo` repeats the training of the shipped agent. Everything in a recipe can be changed:
    `armctl train reach_ppo --seed 1 --shaping ik --set robot=ur10 --option worlds=64`, or
    `armctl train ppo --env armctl/BridgeCross-v0`.

    During training, the agent is evaluated on held-out episodes (`curve.csv`), and the best version is kept. Ctrl-C
    leaves a checkpoint, and the same command with `--resume` resumes from it. Watch the training with
    `tensorboard --logdir FOLDER`.
    """
    from rich import print as show

    from armctl.envs import task_of
    from armctl.learners import load_learner, load_recipe

    chosen = load_recipe(recipe, env)
    given = {"shaping": shaping, "shaping_scale": shaping_scale, "teacher": teacher}
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
    try:
        card = load_learner(chosen.learner)(chosen, out=folder, seed=seed, resume=resume)
    except KeyboardInterrupt:
        show(f"Interrupted. The same command with [bold]--resume --out {folder}[/] resumes the training.")
        raise typer.Exit(130) from None
    assert card.evaluation is not None
    low, high = card.evaluation.success_interval
    show(
        f"{card.training_steps:,} steps in {card.training_minutes} minutes, best after {card.best_after:,}: "
        f"success {card.evaluation.success_rate:.1%} [{low:.1%}, {high:.1%}] "
        f"on {card.evaluation.episodes} held-out episodes"
    )
    rival = task_of(chosen.env).default_policies[0]
    show(f"The agent is {folder / 'agent.json'}: armctl compare {rival} {folder / 'agent.json'} --env {chosen.env}")

"""The verbs of the command line. No logic of its own: each calls the library."""

import sys
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer

from armctl import DEFAULT_ENV, DEFAULT_POLICIES
from armctl.errors import ArmctlError, ConfigurationError
from armctl.options import option_value

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

Env = Annotated[str, typer.Option("--env", help="Environment id; `armctl list` shows them.")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the episodes: the same seed, the same episodes.")]
EnvOptions = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="Option of the environment, as often as needed: `--set robot=ur10 --set tolerance=0.02`.",
    ),
]
Worlds = Annotated[
    int,
    typer.Option(
        min=1, help="Worlds played at once. With 1, decision times are latencies; with more, shares of a batch."
    ),
]

Workers = Annotated[
    int,
    typer.Option(
        min=1,
        help="Processes that play episodes side by side, each on one core. With more than 1, decisions are timed "
        "while others compute beside them.",
    ),
]
Policies = Annotated[
    list[str] | None,
    typer.Argument(
        help="Policies: names, agents' files, or `module:function`.", show_default="those of the environment"
    ),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace results that the folder holds.")]


@app.command("list")
def list_() -> None:
    """Show the environments, policies, arms, disturbances, learners and recipes."""
    from rich.console import Console
    from rich.table import Table

    from armctl.assets import BUILTIN_ARMS
    from armctl.disturbances import ARM, CAMERA, ROVER
    from armctl.evaluation.rollouts import environment_names
    from armctl.learners import learner_names, load_recipe, recipe_names
    from armctl.policies import describe_policy, policy_names

    table = Table.grid(padding=(0, 2))
    for kind, names in (("environments", environment_names()), ("arms", BUILTIN_ARMS), ("learners", learner_names())):
        table.add_row(f"[bold]{kind}[/]", "  ".join(names))
    for i, name in enumerate(policy_names()):
        table.add_row("" if i else "[bold]policies[/]", f"[bold]{name}[/]  {describe_policy(name)}")
    for i, recipe in enumerate(map(load_recipe, recipe_names())):
        helped = " ".join(f"{name} {value}" for name in ("shaping", "teacher") if (value := getattr(recipe, name)))
        table.add_row(
            "" if i else "[bold]recipes[/]", f"[bold]{recipe.name}[/]  {recipe.learner} in {recipe.env} {helped}"
        )
    for robot, kinds in (("arm", ARM), ("rover", ROVER | CAMERA)):
        for i, (name, one) in enumerate(kinds.items()):
            levels = ", ".join(f"{level:g}" for level in one.levels)
            heading = "" if i else f"[bold]disturbances[/] {robot}"
            table.add_row(heading, f"[bold]{name}[/]  {one.does} ({one.unit}): {levels}")
    table.add_row("", "A policy may also be path/to/agent.json or module:function, and an arm path/to/your.urdf.")
    Console(highlight=False).print(table)


@app.command()
def compare(
    policies: Policies = None,
    env: Env = DEFAULT_ENV,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes that every policy meets.")] = 200,
    seed: Seed = 0,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for episodes.csv and summary.json.", show_default="results/<date and time>"),
    ] = None,
    overwrite: Overwrite = False,
    worlds: Worlds = 1,
    workers: Workers = 1,
    env_options: EnvOptions = None,
    report: Annotated[
        bool, typer.Option("--report", help="Write report.html as well, with figures and videos.")
    ] = False,
) -> None:
    """Let policies meet the same episodes, and print who is better, by how much.

    Writes every episode as it ends, so that Ctrl-C loses nothing: the same command with the same `--out` goes on.
    """
    from rich.console import Console

    from armctl.evaluation import EpisodeResult
    from armctl.evaluation import compare as run_comparison
    from armctl.evaluation.compare import default_policies
    from armctl.evaluation.report import tables

    names = policies or default_policies(env)
    folder = out or _new_folder()
    with _progress() as bar:
        bars = {name: bar.add_task(name, total=episodes) for name in names}

        def progress(result: EpisodeResult) -> None:
            bar.advance(bars[result.policy])

        comparison = run_comparison(
            names,
            env,
            episodes=episodes,
            seed=seed,
            out=folder,
            overwrite=overwrite,
            worlds=worlds,
            workers=workers,
            env_options=_options(env_options),
            progress=progress,
        )
    console = Console()
    console.print(tables(comparison))
    console.print(f"{folder / 'episodes.csv'} has every episode, {folder / 'summary.json'} the tables.", soft_wrap=True)
    if comparison.interrupted:
        console.print(f"The same command with --out {folder} goes on from there.", soft_wrap=True)
        raise typer.Exit(130)
    if report:
        _write_report(folder, None, video=True, trusted=True)
    if comparison.failures:
        raise typer.Exit(1)


@app.command()
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder of a comparison's or a sweep's results.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="HTML file to write.", show_default="DIR/report.html")
    ] = None,
    video: Annotated[bool, typer.Option("--video/--no-video", help="Play episodes again, and film them.")] = True,
) -> None:
    """Write the report of a comparison: one HTML file that works offline, on a phone and in print."""
    _write_report(folder, out, video=video, trusted=False)


def _write_report(folder: Path, out: Path | None, *, video: bool, trusted: bool) -> None:
    from rich.console import Console

    from armctl.evaluation.html import write_report

    console = Console()
    with Console(stderr=True).status("report") as status:
        path = write_report(
            folder, out, video=video, trusted=trusted, progress=lambda doing: status.update(f"report: {doing}")
        )
    console.print(f"{path} is the report: open it in a browser.", soft_wrap=True)


@app.command()
def sweep(
    policies: Policies = None,
    env: Env = DEFAULT_ENV,
    disturbances: Annotated[
        list[str] | None,
        typer.Option(
            "--disturbance",
            metavar="NAME[=LEVELS]",
            help="What to disturb with, as often as needed: `--disturbance noise --disturbance payload=0,1,2,4`.",
            show_default="all of the environment's",
        ),
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes that every policy meets at each level.")] = 100,
    seed: Seed = 0,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for sweep.csv and all comparisons.", show_default="results/<date and time>"),
    ] = None,
    overwrite: Overwrite = False,
    worlds: Worlds = 1,
    workers: Workers = 1,
    env_options: EnvOptions = None,
) -> None:
    """Let policies meet the same episodes under ever stronger disturbances, and print how each holds out.

    Disturbances: `noise` of sensors, `delay` of actions, `payload`, `friction`, `strength` of motors, `pushes`,
    `mismatch` between the robot and what controllers believe of it, and `dropout` of camera pictures. Policies that see
    the state are spared noise and dropout. `armctl list` shows the levels.

    Writes every episode as it ends, so that Ctrl-C loses nothing: the same command with the same `--out` goes on.
    """
    from rich.console import Console

    from armctl.evaluation import EpisodeResult
    from armctl.evaluation import sweep as run_sweep
    from armctl.evaluation.compare import default_policies
    from armctl.evaluation.report import sweep_tables
    from armctl.evaluation.sweep import sweep_levels

    names, options = policies or default_policies(env), _options(env_options)
    asked = _levels(disturbances) if disturbances else None
    settings = 1 + sum(len(levels) - 1 for levels in sweep_levels(env, asked, options).values())
    folder = out or _new_folder()
    with _progress() as bar:
        shown = bar.add_task("", total=settings * len(names) * episodes)

        def progress(setting: str, result: EpisodeResult) -> None:
            bar.update(shown, description=setting, advance=1)

        found = run_sweep(
            names,
            env,
            disturbances=asked,
            episodes=episodes,
            seed=seed,
            out=folder,
            overwrite=overwrite,
            worlds=worlds,
            workers=workers,
            env_options=options,
            progress=progress,
        )
    console = Console()
    console.print(sweep_tables(found))
    console.print(f"{folder / 'sweep.csv'} has the curves, and a folder beside it each comparison.", soft_wrap=True)
    if found.interrupted:
        console.print(f"The same command with --out {folder} goes on from there.", soft_wrap=True)
        raise typer.Exit(130)
    if found.failures:
        raise typer.Exit(1)


@app.command()
def run(
    policy: Annotated[str, typer.Argument(help="Policy: a name, an agent's file, or `module:function`.")],
    env: Env = DEFAULT_ENV,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes to play.")] = 1,
    steps: Annotated[
        int | None, typer.Option(min=1, help="Most steps of an episode.", show_default="the environment's")
    ] = None,
    seed: Seed = 0,
    video: Annotated[Path | None, typer.Option(metavar="FILE.mp4", help="Record what happens.")] = None,
    watch: Annotated[bool, typer.Option("--watch", help="Show it in MuJoCo's window, in real time.")] = False,
    env_options: EnvOptions = None,
) -> None:
    """Play episodes with one policy, and print its states, actions and rewards."""
    from armctl.evaluation.runner import run_episodes

    if not run_episodes(policy, env, episodes, steps, seed, video, watch, _options(env_options)):
        raise typer.Exit(130)


@app.command()
def view(
    policy: Annotated[str, typer.Argument(help="Policy: a name, an agent's file, or `module:function`.")],
    env: Env = DEFAULT_ENV,
    seed: Seed = 0,
    episode: Annotated[int, typer.Option(min=0, help="Number of the first episode.")] = 0,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Of the page.", show_default="the first free one from 8080 on")
    ] = 0,
    open_browser: Annotated[bool, typer.Option("--open/--no-open", help="Open a browser, where there is one.")] = True,
    native: Annotated[bool, typer.Option("--native", help="Show it in MuJoCo's own window; needs a screen.")] = False,
    env_options: EnvOptions = None,
) -> None:
    """Show a policy live in the browser, in real time: its plan, contacts and rewards as well.

    A panel on the page has the policies, seeds and episodes to choose from. Keys: Space pauses, Right arrow makes one
    decision, R plays the episode again, N the next one; the mouse turns the view. Ctrl-C ends it. The page is for this
    machine alone; from another: `ssh -L 8080:localhost:8080 HOST`.
    """
    from armctl.evaluation.stage import Stage
    from armctl.evaluation.viewer import Player, show_in_browser
    from armctl.evaluation.window import check_screen, show_in_window

    if native:
        check_screen()
    player = Player(Stage(policy, env, seed, episode, _options(env_options)))
    try:
        show_in_window(player) if native else show_in_browser(player, port, open_browser)
    except KeyboardInterrupt:
        raise typer.Exit(130) from None


@app.command()
def collect(
    policy: Annotated[str, typer.Argument(help="Policy: a name, an agent's file, or `module:function`.")],
    out: Annotated[Path, typer.Option(metavar="DATASET", help="Folder of the dataset, such as `data/reach_ik-v0`.")],
    env: Env = DEFAULT_ENV,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes to play.")] = 500,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the episodes; training seed k plays those from (k + 1) * 10^9.")
    ] = 10**9,
    worlds: Annotated[int, typer.Option(min=1, help="Worlds played at once.")] = 50,
    env_options: EnvOptions = None,
) -> None:
    """Write a policy's episodes to a Minari dataset, from which `bc` can learn; needs the extra `rl`.

    Ctrl-C keeps the episodes that were finished.
    """
    from rich.console import Console
    from rich.progress import track

    from armctl.evaluation import EpisodeResult
    from armctl.evaluation.demonstrations import collect as run_collection

    console = Console(stderr=True)
    ended = iter(track(range(episodes), policy, console=console, transient=True))

    def progress(result: EpisodeResult) -> None:
        next(ended, None)

    collection = run_collection(
        policy, env, episodes=episodes, out=out, seed=seed, worlds=worlds, env_options=_options(env_options),
        progress=progress,
    )  # fmt: skip
    Console().print(
        f"{collection.episodes} episodes of {policy}, {collection.steps} decisions, "
        f"{collection.successes} successes: {out}",
        soft_wrap=True,
    )
    if collection.interrupted:
        raise typer.Exit(130)


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
    steps: Annotated[
        int | None, typer.Option(min=1, help="Decisions in simulation.", show_default="the recipe's")
    ] = None,
    shaping: Annotated[
        str | None,
        typer.Option(
            metavar="ORACLE",
            help="Potential-based reward on the way: `distance`, `ik`, `mpc`, `ompl` or `none`.",
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
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the newest checkpoint in the folder.")] = False,
) -> None:
    """Train an agent by a recipe; needs the extra `rl`.

    The extra: `pip install 'armctl[rl]'`, or `pip install -e '.[rl]'` in a clone.

    `armctl train reach_ppo` repeats how the shipped agent was made. All of a recipe can be changed:
    `armctl train reach_ppo --seed 1 --shaping ik --set robot=ur10 --option worlds=64`, or
    `armctl train ppo --env armctl/BridgeCross-v0`.

    While it learns, the agent is judged on held-out episodes (`curve.csv`), and the best is kept. Ctrl-C leaves a
    checkpoint: the same command with `--resume` goes on. Watch it with `tensorboard --logdir FOLDER`.
    """
    from rich import print as show

    from armctl.learners import load_learner, load_recipe

    chosen = load_recipe(recipe, env)
    given = {"shaping": shaping, "shaping_scale": shaping_scale, "teacher": teacher}
    changes: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    if shaping == "none":
        changes["shaping"] = None
    learner_options = _options(options, "--option") | ({} if steps is None else {"steps": steps})
    chosen = chosen.changed(
        **changes,
        options=chosen.options | learner_options,
        env_options=chosen.env_options | _options(env_options),
    )
    seed = chosen.seeds[0] if seed is None else seed
    folder = out or Path("runs") / f"{chosen.name}-{seed}"
    try:
        card = load_learner(chosen.learner)(chosen, out=folder, seed=seed, resume=resume)
    except KeyboardInterrupt:
        show(f"Interrupted. The same command with [bold]--resume --out {folder}[/] goes on.")
        raise typer.Exit(130) from None
    assert card.evaluation is not None
    low, high = card.evaluation.success_interval
    show(
        f"{card.training_steps:,} steps in {card.training_minutes} minutes, best after {card.best_after:,}: "
        f"success {card.evaluation.success_rate:.1%} [{low:.1%}, {high:.1%}] "
        f"on {card.evaluation.episodes} held-out episodes"
    )
    rival = DEFAULT_POLICIES[chosen.env][0]
    show(f"The agent is {folder / 'agent.json'}: armctl compare {rival} {folder / 'agent.json'} --env {chosen.env}")


@app.command()
def reproduce(
    agents: Annotated[list[str], typer.Argument(help="Agents: their cards' paths, or the names of shipped ones.")],
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of other episodes.", show_default="the card's: the same episodes")
    ] = None,
    worlds: Annotated[int, typer.Option(min=1, help="Worlds played at once.")] = 64,
) -> None:
    """Evaluate learned agents again, and compare with what their cards say.

    An agent agrees if its success rate is within the 95 % interval on its card. If one does not, the exit status is 1.
    """
    from rich.console import Console
    from rich.table import Table

    from armctl.evaluation.reproduce import reproduce as run_again

    table = Table("agent", "episodes", "on the card", "95 %", "now", "steps, card", "steps, now", "agrees")
    agreed, console = True, Console()
    for agent in agents:
        with console.status(f"{agent}: playing its episodes again"):
            again = run_again(agent, seed=seed, worlds=worlds)
        claimed, found, agreed = again.claimed, again.found, agreed and again.agrees
        low, high = claimed.success_interval
        steps = (f"{one.mean_steps_to_goal:.1f}" if one.mean_steps_to_goal else "-" for one in (claimed, found))
        table.add_row(
            again.card.name,
            f"{found.episodes} of seed {found.seed}",
            f"{claimed.success_rate:.1%}",
            f"{low:.1%} to {high:.1%}",
            f"{found.success_rate:.1%}",
            *steps,
            "yes" if again.agrees else "[red]no[/]",
        )
    console.print(table)
    if not agreed:
        raise typer.Exit(1)


def _new_folder() -> Path:
    from datetime import datetime

    return Path("results") / datetime.now().strftime("%Y-%m-%d_%H-%M-%S")


def _progress() -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description:>12}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True), transient=True)


def _levels(given: list[str]) -> dict[str, Any]:
    """Levels by disturbance from NAME=LEVEL,LEVEL...; None from NAME alone."""
    levels: dict[str, Any] = {}
    for one in given:
        name, equals, numbers = one.partition("=")
        levels[name] = option_value(f"[{numbers}]") if equals else None
    return levels


def _options(pairs: list[str] | None, flag: str = "--set") -> dict[str, Any]:
    """Options from NAME=VALUE pairs: numbers, tuples, True, False and None, or else strings."""
    options = {}
    for pair in pairs or []:
        name, equals, value = pair.partition("=")
        if not equals:
            raise ConfigurationError(f"{flag} wants NAME=VALUE, not {pair!r}")
        options[name] = option_value(value)
    return options


def main() -> NoReturn:
    """Run the command line; armctl's own errors become one line and exit status 2."""
    try:
        app()
    except ArmctlError as error:
        from rich.console import Console
        from rich.text import Text

        Console(stderr=True).print(Text.assemble(("armctl: ", "red"), str(error)), soft_wrap=True)
        sys.exit(2)
    sys.exit(0)

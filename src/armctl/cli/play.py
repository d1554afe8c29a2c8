"""Verbs that play: `run`, `view`, `collect`."""

from pathlib import Path
from typing import Annotated

import typer

from armctl import DEFAULT_ENV
from armctl.cli.app import app
from armctl.cli.options import (
    Env,
    EnvOptions,
    On,
    PolicyName,
    PolicySeed,
    Seed,
    Workers,
    options_of,
    progress_bar,
)


@app.command()
def run(
    policy: PolicyName,
    env: Env = DEFAULT_ENV,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes to play.")] = 1,
    steps: Annotated[
        int | None, typer.Option(min=1, help="Largest number of steps per episode.", show_default="the environment's")
    ] = None,
    seed: Seed = 0,
    episode: Annotated[int, typer.Option(min=0, help="Number of the first episode.")] = 0,
    video: Annotated[Path | None, typer.Option(metavar="FILE.mp4", help="Record a video.")] = None,
    watch: Annotated[bool, typer.Option("--watch", help="Show it in a window, in real time.")] = False,
    rerun: Annotated[
        Path | None,
        typer.Option(metavar="FILE.rrd", help="Record everything for Rerun's viewer; needs the extra `rerun`."),
    ] = None,
    env_options: EnvOptions = None,
    policy_seed: PolicySeed = None,
) -> None:
    """Play episodes with one policy, and print its states, actions and rewards."""
    from armctl.viewer.terminal import run_episodes

    log = None
    if rerun:
        from armctl.integrations.rerun import rerun_opener

        log = rerun_opener(rerun)
    options = options_of(env_options)
    if not run_episodes(policy, env, episodes, steps, seed, video, watch, options, episode, log, policy_seed):
        raise typer.Exit(130)


@app.command()
def view(
    policy: PolicyName,
    env: Env = DEFAULT_ENV,
    seed: Seed = 0,
    episode: Annotated[int, typer.Option(min=0, help="Number of the first episode.")] = 0,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of the page.", show_default="the first free one from 8080 on")
    ] = 0,
    open_browser: Annotated[bool, typer.Option("--open/--no-open", help="Open a browser, if there is one.")] = True,
    native: Annotated[bool, typer.Option("--native", help="Show it in MuJoCo's own window; needs a screen.")] = False,
    env_options: EnvOptions = None,
    policy_seed: PolicySeed = None,
) -> None:
    """Show a policy live in the browser, in real time, with its plans, contacts and rewards.

    A panel on the page selects policy, seed and episode. Keys: Space pauses, Right arrow makes one control step, R
    restarts the episode, N starts the next one; drag with the mouse to rotate the view. Ctrl-C ends the program. The
    page is served to this machine only, at the address that is printed, whose token lets you in; from another machine,
    use `ssh -L 8080:localhost:8080 HOST` and the same address.
    """
    from armctl.viewer.browser import Player, show_in_browser
    from armctl.viewer.stage import Stage
    from armctl.viewer.window import check_screen, show_in_window

    if native:
        check_screen()
    player = Player(Stage(policy, env, seed, episode, options_of(env_options), policy_seed=policy_seed))
    try:
        show_in_window(player) if native else show_in_browser(player, port, open_browser)
    except KeyboardInterrupt:
        raise typer.Exit(130) from None


@app.command()
def collect(
    policy: PolicyName,
    out: Annotated[Path, typer.Option(metavar="DATASET", help="Folder of the dataset, such as `data/reach_ik-v0`.")],
    env: Env = DEFAULT_ENV,
    episodes: Annotated[int, typer.Option(min=1, help="Episodes to play.")] = 500,
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the episodes; training seed k plays those from (k + 1) * 10^9.")
    ] = 10**9,
    worlds: Annotated[int, typer.Option(min=1, help="Worlds stepped at once, in each worker.")] = 50,
    workers: Workers = 1,
    on: On = "local",
    env_options: EnvOptions = None,
    policy_seed: PolicySeed = None,
    format: Annotated[
        str, typer.Option(help="`minari`, from which `bc` can learn (extra `rl`), or `lerobot` (extra `lerobot`).")
    ] = "minari",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the dataset in the folder.")] = False,
) -> None:
    """Write a policy's episodes to a dataset for learners, in the format of Minari or LeRobot.

    Ctrl-C keeps the finished episodes, and the same command resumes. So it does after a full disk or a crash. The
    dataset is the same wherever its episodes are played; workers play blocks of 4 episodes per world.
    """
    from armctl.core.console import PlainConsole
    from armctl.datasets.collect import collect as run_collection
    from armctl.runtime.engines import connect

    with connect(on, workers) as engine, progress_bar() as bar:
        task = bar.add_task(policy, total=episodes)
        collection = run_collection(
            policy, env, episodes=episodes, out=out, seed=seed, worlds=worlds, workers=engine,
            env_options=options_of(env_options), format=format, overwrite=overwrite,
            policy_seed=policy_seed,
            progress=lambda finished: bar.update(task, completed=finished),
        )  # fmt: skip
    console = PlainConsole()
    if collection.resumed:
        console.print(f"Resumed: {collection.resumed} of {episodes} episodes were there already.", soft_wrap=True)
    console.print(
        f"{collection.episodes} episodes of {policy}, {collection.steps} control steps, "
        f"{collection.successes} successes: {out}",
        soft_wrap=True,
    )
    if collection.interrupted:
        console.print(f"Interrupted after {collection.episodes} of {episodes}. The same command resumes.")
        raise typer.Exit(130)

"""Verbs that play: `run`, `view`, `collect`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from armctl import DEFAULT_ENV
from armctl.cli.app import verb
from armctl.cli.options import (
    Env,
    EnvOptions,
    On,
    PolicyName,
    PolicySeed,
    Robot,
    Seed,
    Workers,
    environment_options,
    progress_bar,
)

FirstEpisode = Annotated[int, typer.Option(min=0, help="Number of the first episode.")]


@dataclass(frozen=True)
class RunRequest:
    """Options of `run`."""

    policy: PolicyName
    env: Env = DEFAULT_ENV
    episodes: Annotated[int, typer.Option(min=1, help="Episodes to play.")] = 1
    steps: Annotated[
        int | None, typer.Option(min=1, help="Largest number of steps per episode.", show_default="the environment's")
    ] = None
    seed: Seed = 0
    episode: FirstEpisode = 0
    video: Annotated[Path | None, typer.Option(metavar="FILE.mp4", help="Record a video.")] = None
    watch: Annotated[bool, typer.Option("--watch", help="Show it in a window, in real time.")] = False
    rerun: Annotated[
        Path | None,
        typer.Option(metavar="FILE.rrd", help="Record everything for Rerun's viewer; needs the extra `rerun`."),
    ] = None
    robot: Robot = None
    env_options: EnvOptions = None
    policy_seed: PolicySeed = None


@verb
def run(request: RunRequest) -> None:
    """Play episodes with one policy, and print its states, actions and rewards."""
    env_options = environment_options(request.env, request.env_options, robot=request.robot)
    from armctl.viewer.terminal import Outputs, run_episodes

    log = None
    if request.rerun:
        from armctl.integrations.rerun import rerun_opener

        log = rerun_opener(request.rerun)
    finished = run_episodes(
        request.policy,
        request.env,
        range(request.episode, request.episode + request.episodes),
        request.seed,
        steps=request.steps,
        env_options=env_options,
        outputs=Outputs(request.video, request.watch, log),
        policy_seed=request.policy_seed,
    )
    if not finished:
        raise typer.Exit(130)


@dataclass(frozen=True)
class ViewRequest:
    """Options of `view`."""

    policy: PolicyName
    env: Env = DEFAULT_ENV
    seed: Seed = 0
    episode: FirstEpisode = 0
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of the page.", show_default="the first free one from 8080 on")
    ] = 0
    open_browser: Annotated[bool, typer.Option("--open/--no-open", help="Open a browser, if there is one.")] = True
    native: Annotated[bool, typer.Option("--native", help="Show it in MuJoCo's own window; needs a screen.")] = False
    robot: Robot = None
    env_options: EnvOptions = None
    policy_seed: PolicySeed = None


@verb
def view(request: ViewRequest) -> None:
    """Show a policy live in the browser, in real time, with its plans, contacts and rewards.

    A panel on the page selects policy, seed and episode. Keys: Space pauses, Right arrow makes one control step, R
    restarts the episode, N starts the next one; drag with the mouse to rotate the view. Ctrl-C ends the program. The
    page is served to this machine only, at the address that is printed, whose token lets you in; from another machine,
    use `ssh -L 8080:localhost:8080 HOST` and the same address.
    """
    options = environment_options(request.env, request.env_options, robot=request.robot)
    from armctl.viewer.browser import Player, show_in_browser
    from armctl.viewer.stage import Stage
    from armctl.viewer.window import check_screen, show_in_window

    if request.native:
        check_screen()
    stage = Stage(request.policy, request.env, request.seed, request.episode, options, policy_seed=request.policy_seed)
    player = Player(stage)
    try:
        show_in_window(player) if request.native else show_in_browser(player, request.port, request.open_browser)
    except KeyboardInterrupt:
        raise typer.Exit(130) from None


@dataclass(frozen=True)
class CollectRequest:
    """Options of `collect`."""

    policy: PolicyName
    out: Annotated[Path, typer.Option(metavar="DATASET", help="Folder of the dataset, such as `data/reach_ik-v0`.")]
    env: Env = DEFAULT_ENV
    episodes: Annotated[int, typer.Option(min=1, help="Episodes to play.")] = 500
    seed: Annotated[
        int, typer.Option(min=0, help="Seed of the episodes; training seed k plays those from (k + 1) * 10^9.")
    ] = 10**9
    worlds: Annotated[int, typer.Option(min=1, help="Worlds stepped at once, in each worker.")] = 50
    workers: Workers = 1
    on: On = "local"
    robot: Robot = None
    env_options: EnvOptions = None
    policy_seed: PolicySeed = None
    format: Annotated[
        str, typer.Option(help="`minari`, from which `bc` can learn (extra `rl`), or `lerobot` (extra `lerobot`).")
    ] = "minari"
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the dataset in the folder.")] = False


@verb
def collect(request: CollectRequest) -> None:
    """Write a policy's episodes to a dataset for learners, in the format of Minari or LeRobot.

    Ctrl-C keeps the finished episodes, and the same command resumes. The same holds after a full disk or a crash. The
    dataset is the same wherever its episodes are played; workers play blocks of 4 episodes per world.
    """
    env_options = environment_options(request.env, request.env_options, robot=request.robot)
    from armctl.core.console import PlainConsole
    from armctl.datasets.collect import collect as run_collection
    from armctl.runtime.engines import connect

    policy, episodes = request.policy, request.episodes
    with connect(request.on, request.workers) as engine, progress_bar() as bar:
        task = bar.add_task(policy, total=episodes)
        collection = run_collection(
            policy, request.env, episodes=episodes, out=request.out, seed=request.seed, worlds=request.worlds,
            workers=engine, env_options=env_options, format=request.format,
            overwrite=request.overwrite, policy_seed=request.policy_seed,
            progress=lambda finished: bar.update(task, completed=finished),
        )  # fmt: skip
    console = PlainConsole()
    if collection.resumed:
        console.print(f"Resumed: {collection.resumed} of {episodes} episodes were there already.", soft_wrap=True)
    console.print(
        f"{collection.episodes} episodes of {policy}, {collection.steps} control steps, "
        f"{collection.successes} successes: {request.out}",
        soft_wrap=True,
    )
    if collection.interrupted:
        console.print(f"Interrupted after {collection.episodes} of {episodes}. The same command resumes.")
        raise typer.Exit(130)

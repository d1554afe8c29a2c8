"""What imagination adds to learned agents, for each training seed of their networks, on the test's episodes."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from armctl.agents import load_agent, read_card
from armctl.evaluation import evaluate
from armctl.evaluation.seeds import TEST_SEED
from armctl.evaluation.statistics import success_rate
from armctl.policies import Policy, sees
from armctl.rl.imagining import ImaginingPolicy
from armctl.rl.looking_ahead import looking_ahead
from armctl.rl.zoo import HOME

OBSTACLES, PEOPLE = "armctl/ArmReachObstacles-v0", "armctl/BridgeCrossMoving-v0"


def obstacles_imagined(card: Path) -> Callable[[Any], Policy]:
    """`obstacles_imagined` with another network."""
    return sees("model")(lambda env: ImaginingPolicy(load_agent(card, env), env))


def bridge_moving_imagined(card: Path) -> Callable[[Any], Policy]:
    """`bridge_moving_imagined` with another network."""
    return sees("state")(lambda env: looking_ahead(card, env))


def main(episodes: Annotated[int, typer.Option(min=1, help="Episodes of each agent.")] = 500) -> None:
    """Print a table: success of each network by itself, which is on its card, and with imagination."""
    print(
        "| environment | network | seed | by itself, % | with imagination, % | 95 % interval |",
        "|---|---|---|---|---|---|",
        sep="\n",
    )
    for env, options, network, imagined in (
        (OBSTACLES, {}, "obstacles_plan_bc", obstacles_imagined),
        (PEOPLE, {"observation": "state"}, "bridge_moving_state_ppo", bridge_moving_imagined),
    ):
        for card in [HOME / "agents" / f"{network}.json", *sorted((HOME / "agents/seeds").glob(f"{network}-*.json"))]:
            played = evaluate(
                imagined(card), env, episodes=episodes, seed=TEST_SEED, worlds=50, env_options=options,
                least_lengths=False,
            )  # fmt: skip
            rate = success_rate(played.success.to_numpy(bool))
            alone = read_card(card)
            print(
                f"| {env.removeprefix('armctl/')} | `{network}` | {alone.training_seed} "
                f"| {100 * alone.evaluation.success_rate:.1f} | {100 * rate.value:.1f} "
                f"| {100 * rate.low:.1f} to {100 * rate.high:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    typer.run(main)

"""Gain of learned agents by imagination: on the same episodes of the test, for each training of their networks."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from rich.progress import track

import armctl
from armctl.agents import read_card
from armctl.baselines.hybrids.guided_planner import guided
from armctl.baselines.hybrids.lookahead import LookaheadOptions, lookahead
from armctl.core.seeds import TEST_SEED
from armctl.policies import Policy, sees
from armctl.rl.agents import AGENTS

COLUMNS = (
    "network", "seed", "success by itself, %", "with imagination, %", "paired difference, points", "steps by itself",
    "with imagination",
)  # fmt: skip


def main(
    networks: Annotated[
        list[str] | None, typer.Argument(help="Networks; without any, all.", show_default=False)
    ] = None,
    episodes: Annotated[int, typer.Option(min=1, help="Most episodes of each agent.")] = 500,
) -> None:
    """Print a table of networks by themselves and with imagination. Steps: a failure counts as the time limit."""
    rows = [COLUMNS, ("---",) * len(COLUMNS)]
    for network in networks or NETWORKS:
        cards = [AGENTS / f"{network}.json", *sorted((AGENTS / "seeds").glob(f"{network}-*.json"))]
        rows += [_row(card, episodes, NETWORKS[network]) for card in track(cards, network)]
    print("\n".join(f"| {' | '.join(row)} |" for row in rows))


def _guided(card: Path) -> Callable[[Any], Policy]:
    return sees("model")(lambda env: guided("imagined", card, env, {}))


def _lookahead(card: Path) -> Callable[[Any], Policy]:
    return sees("state")(lambda env: lookahead(card, env, LookaheadOptions(prepared=False)))


class Network(NamedTuple):
    """Way in which a network is tried."""

    imagined: Callable[[Path], Callable[[Any], Policy]]
    env_options: dict[str, Any]
    max_episodes: int
    """Episodes that differ."""


NETWORKS = {
    "obstacles_plan_bc": Network(_guided, {}, 500),
    "scenes_plan_bc": Network(_guided, {"problems": "test"}, 132),
    "bridge_moving_state_ppo": Network(_lookahead, {}, 500),
}


def _row(path: Path, episodes: int, network: Network) -> tuple[str, ...]:
    card = read_card(path)
    comparison = armctl.compare(
        [network.imagined(path), path],
        card.env,
        episodes=min(episodes, network.max_episodes),
        seed=TEST_SEED,
        worlds=50,
        env_options=network.env_options,
    )
    with_it, network_only = comparison.policies
    difference = comparison.differences[0].success_difference
    return (
        f"`{card.recipe}`",
        str(card.training_seed),
        *(f"{100 * summary.success.value:.1f} [{100 * summary.success.low:.1f}, {100 * summary.success.high:.1f}]"
          for summary in (network_only, with_it)),
        f"{100 * difference.value:+.1f} [{100 * difference.low:.1f}, {100 * difference.high:.1f}]",
        *(f"{summary.restricted_steps.value:.1f}" for summary in (network_only, with_it)),
    )  # fmt: skip


if __name__ == "__main__":
    typer.run(main)

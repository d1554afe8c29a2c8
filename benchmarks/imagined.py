"""Gain of learned agents by imagination: on the same episodes of the test, for each training of their networks."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import track

import armctl
from armctl.agents import load_agent, read_card
from armctl.baselines.hybrids.lookahead import LookaheadOptions, lookahead
from armctl.baselines.hybrids.shooting import ShootingPolicy
from armctl.core.seeds import TEST_SEED
from armctl.policies import Policy, sees
from armctl.rl.agents import AGENTS

COLUMNS = (
    "network", "seed", "success by itself, %", "with imagination, %", "paired difference, points", "steps by itself",
    "with imagination",
)  # fmt: skip


def main(episodes: Annotated[int, typer.Option(min=1, help="Episodes of each agent.")] = 500) -> None:
    """Print a table of networks by themselves and with imagination. Steps: a failure counts as the time limit."""
    rows = [COLUMNS, ("---",) * len(COLUMNS)]
    for network, imagined in (("obstacles_plan_bc", _shooting), ("bridge_moving_state_ppo", _lookahead)):
        cards = [AGENTS / f"{network}.json", *sorted((AGENTS / "seeds").glob(f"{network}-*.json"))]
        rows += [_row(network, card, imagined(card), episodes) for card in track(cards, network)]
    print("\n".join(f"| {' | '.join(row)} |" for row in rows))


def _shooting(card: Path) -> Callable[[Any], Policy]:
    return sees("model")(lambda env: ShootingPolicy(load_agent(card, env), env))


def _lookahead(card: Path) -> Callable[[Any], Policy]:
    return sees("state")(lambda env: lookahead(card, env, LookaheadOptions(prepared=False)))


def _row(network: str, path: Path, imagined: Callable[[Any], Policy], episodes: int) -> tuple[str, ...]:
    card = read_card(path)
    comparison = armctl.compare([imagined, path], card.env, episodes=episodes, seed=TEST_SEED, worlds=50)
    with_it, network_only = comparison.policies
    difference = comparison.differences[0].success_difference
    return (
        f"`{network}`",
        str(card.training_seed),
        *(f"{100 * summary.success.value:.1f} [{100 * summary.success.low:.1f}, {100 * summary.success.high:.1f}]"
          for summary in (network_only, with_it)),
        f"{100 * difference.value:+.1f} [{100 * difference.low:.1f}, {100 * difference.high:.1f}]",
        *(f"{summary.restricted_steps.value:.1f}" for summary in (network_only, with_it)),
    )  # fmt: skip


if __name__ == "__main__":
    typer.run(main)

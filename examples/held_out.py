"""Arguments of the examples, and the held-out episodes on which they count successes."""

import argparse
from collections.abc import Sequence
from typing import Any

import torch

import armctl
from armctl.core.seeds import TRAINING_SEEDS
from armctl.stats.intervals import success_rate

MAX_THREADS = 4
"""Limit on threads: small networks gain nothing from more. `OMP_NUM_THREADS` can lower it further."""
MAX_SEED = 2**32 - 1
"""Largest seed of NumPy's global generator, which most libraries seed too."""


def arguments(
    description: str | None, steps: int, **choices: Sequence[str]
) -> argparse.Namespace:
    """Return `steps` and `seed` of the training and the number of held-out `episodes`; bound the threads of torch.

    `choices` are further arguments with their allowed values, the default first.
    """
    parser = argparse.ArgumentParser(
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--steps",
        type=_from_to(1, 10**12),
        default=steps,
        help=f"Steps of the training (default: {steps:,}).",
    )
    parser.add_argument(
        "--seed",
        type=_from_to(0, MAX_SEED),
        default=TRAINING_SEEDS,
        help="Seed of the training (default: %(default)s).",
    )
    parser.add_argument(
        "--episodes",
        type=_from_to(1, 10**6),
        default=200,
        help="Held-out episodes (default: %(default)s).",
    )
    for name, allowed in choices.items():
        parser.add_argument(
            f"--{name}",
            choices=allowed,
            default=allowed[0],
            help="Default: %(default)s.",
        )
    torch.set_num_threads(min(torch.get_num_threads(), MAX_THREADS))
    return parser.parse_args()


def report(policy: Any, env: str, episodes: int, **options: Any) -> None:
    """Print a policy's success on episodes of seed 0, for development only.

    `policy` is a model with `predict`, a function from one observation to an
    action, or the path of an agent's card.
    `options` are those of the environment.
    """
    played = armctl.evaluate(
        policy,
        env,
        episodes=episodes,
        worlds=min(episodes, 50),
        env_options=options,
        lower_bound_steps=False,
    )
    success = success_rate(played.success.to_numpy(dtype=bool))
    assert success is not None
    print(
        f"success on {episodes} held-out episodes: {success.value:.1%} "
        f"[{success.low:.1%}, {success.high:.1%}]"
    )


def _from_to(low: int, high: int) -> Any:
    def whole_number(text: str) -> int:
        if not (text.isdecimal() and low <= int(text) <= high):
            raise argparse.ArgumentTypeError(
                f"{text!r} is not a whole number from {low:,} to {high:,}"
            )
        return int(text)

    return whole_number

"""What the examples share: their arguments, and the held-out episodes on which they count successes."""

import argparse
from collections.abc import Sequence
from typing import Any

import torch

import armctl
from armctl.rollout.seeds import TRAINING_SEEDS
from armctl.stats.intervals import success_rate

MOST_THREADS = 4
"""More do not pay for networks as small as these; `OMP_NUM_THREADS` can lower it further."""
MOST_SEED = 2**32 - 1
"""The largest that NumPy's global generator takes, which most libraries seed too."""


def arguments(description: str | None, steps: int, **choices: Sequence[str]) -> argparse.Namespace:
    """`steps` to train, `seed` of the training, and `episodes` to judge it by; bounds the threads of torch.

    `choices` are further arguments, by default the first of what each may be.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=_from_to(1, 10**12), default=steps, help=f"of training (default: {steps:,})")
    parser.add_argument(
        "--seed", type=_from_to(0, MOST_SEED), default=TRAINING_SEEDS, help="of the training (default: %(default)s)"
    )
    parser.add_argument(
        "--episodes", type=_from_to(1, 10**6), default=200, help="that are held out (default: %(default)s)"
    )
    for name, allowed in choices.items():
        parser.add_argument(f"--{name}", choices=allowed, default=allowed[0], help="default: %(default)s")
    torch.set_num_threads(min(torch.get_num_threads(), MOST_THREADS))
    return parser.parse_args()


def report(policy: Any, env: str, episodes: int, **options: Any) -> None:
    """Print a policy's success on episodes of seed 0, which is for development: training's seeds are other ones.

    `policy` is a model with `predict`, or a function from one observation to an action. `options` are those of the
    environment.
    """
    played = armctl.evaluate(
        policy, env, episodes=episodes, worlds=min(episodes, 50), env_options=options, least_lengths=False
    )
    success = success_rate(played.success.to_numpy(dtype=bool))
    assert success is not None
    print(f"success on {episodes} held-out episodes: {success.value:.1%} [{success.low:.1%}, {success.high:.1%}]")


def _from_to(least: int, most: int) -> Any:
    def whole_number(text: str) -> int:
        if not (text.isdecimal() and least <= int(text) <= most):
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from {least:,} to {most:,}")
        return int(text)

    return whole_number

"""Random numbers for policies, from which neither the seed nor the number of an episode can be found.

They are derived from a secret of the run, the policy seed, by a keyed hash (BLAKE2b, RFC 7693). Without its
128 bits, nothing can search for seeds whose random numbers fit.
"""

import hashlib
import secrets
from dataclasses import dataclass, field

import numpy as np

from armctl.core.errors import ConfigurationError

BITS = 128
"""Size of a policy seed."""


def new_policy_seed() -> int:
    """Return a new secret."""
    return secrets.randbits(BITS)


def check_policy_seed(policy_seed: int) -> None:
    """Raise `ConfigurationError` for what is not a whole number of up to 128 bits."""
    if isinstance(policy_seed, bool) or not isinstance(policy_seed, int) or not 0 <= policy_seed < 2**BITS:
        raise ConfigurationError(f"policy_seed is a whole number from 0 to 2^{BITS} - 1, not {policy_seed!r}")


def chosen_policy_seed(explicit: int | None, stored: int | None = None) -> int:
    """Return the policy seed of a run: the one that is asked for, or that of its folder, or a new one."""
    if explicit is not None:
        check_policy_seed(explicit)
        return explicit
    return new_policy_seed() if stored is None else stored


@dataclass(frozen=True)
class PolicyStreams:
    """The random numbers of one policy in one run: a stream for each episode."""

    name: str
    """The policy's name in results, so that two policies of a run do not share their random numbers."""
    policy_seed: int = field(default_factory=new_policy_seed, repr=False)

    def __post_init__(self) -> None:
        check_policy_seed(self.policy_seed)

    def generator(self, *of: int) -> np.random.Generator:
        """Return the generator of an episode, `of` seed and number, or of a world that has begun none."""
        key = self.policy_seed.to_bytes(BITS // 8, "little")
        mixed = hashlib.blake2b(repr((self.name, *of)).encode(), key=key, digest_size=BITS // 8).digest()
        return np.random.default_rng(int.from_bytes(mixed, "little"))

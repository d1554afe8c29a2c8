"""Random damage to files."""

import random

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st


def mutated_bytes(rng, content):
    """The same bytes with some changed, cut out, doubled, or the end cut off."""
    changed = bytearray(content)
    for _ in range(rng.randint(1, 4)):
        changed = changed or bytearray(b"x")
        start = rng.randrange(len(changed))
        end = min(len(changed), start + int(10 ** rng.uniform(0, 3)))
        match rng.randrange(8):
            case 0:
                del changed[start:end]
            case 1:
                changed[start:start] = changed[start:end]
            case 2:
                del changed[start:]
            case _:
                changed[start] ^= rng.randrange(1, 256)
    return bytes(changed)


def outcomes_of(load, mutate, count):
    """The kinds of answers that `mutate(load, rng)` gives, so many times."""
    outcomes = set()

    @settings(
        max_examples=count, deadline=None, database=None, suppress_health_check=list(HealthCheck),
        derandomize=count < 100,  # quick tests are the same each time
    )  # fmt: skip
    @given(st.integers(0, 2**63))
    def each_loads_or_is_refused(seed):
        outcomes.add(mutate(load, random.Random(seed))[0])

    each_loads_or_is_refused()
    return outcomes

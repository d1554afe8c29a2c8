"""Two disturbances at once: the grids of a sweep."""

from collections.abc import Mapping, Sequence

from armctl.core.errors import ConfigurationError
from armctl.disturbances import DisturbanceSpec
from armctl.episodes.stored import SLOW_DOWN_NAME
from armctl.study.grid import Grid
from armctl.study.levels import Disturbances, checked_levels

Pairs = Sequence[Disturbances] | str
"""Pairs of disturbances, each as names or as levels by name; `default` means `DEFAULT_PAIRS`."""
DEFAULT = "default"
DEFAULT_PAIRS = (("delay", "noise"), ("payload", "friction"), ("mismatch", "noise"))
"""Pairs that a task plays if it has both; noise is that of the state too where there is such a one."""
NUM_LEVELS = 3
"""Levels of each disturbance, by default, besides the one that changes nothing."""


def checked_grids(specs: Mapping[str, DisturbanceSpec], pairs: Pairs) -> list[Grid]:
    """Return the grids of pairs of disturbances. Raise `ConfigurationError`."""
    if isinstance(pairs, str):
        if pairs != DEFAULT:
            raise ConfigurationError(f"pairs of disturbances are a list of pairs, or {DEFAULT!r}, not {pairs!r}")
        pairs = default_pairs(specs)
    grids = [_grid(specs, pair) for pair in pairs]
    if len({grid.name for grid in grids}) < len(grids):
        raise ConfigurationError("a pair of disturbances is there twice: give all of its levels at once")
    return grids


def default_pairs(specs: Mapping[str, DisturbanceSpec]) -> list[tuple[str, str]]:
    """Return those of `DEFAULT_PAIRS` that a task has. Raise `ConfigurationError` if there are none."""
    noise = "noise_on_state" if "noise_on_state" in specs else "noise"
    pairs = [(first, noise if second == "noise" else second) for first, second in DEFAULT_PAIRS]
    possible = [pair for pair in pairs if specs.keys() >= set(pair)]
    if not possible:
        usual = ", ".join(f"{first},{second}" for first, second in DEFAULT_PAIRS)
        raise ConfigurationError(f"this environment has none of the default pairs ({usual}): name two disturbances")
    return possible


def _grid(specs: Mapping[str, DisturbanceSpec], pair: Disturbances) -> Grid:
    levels = checked_levels(specs, {} if pair is None else pair)
    if len(levels) != 2:
        raise ConfigurationError(f"a pair is two different disturbances, not {', '.join(levels) or 'none'}")
    if SLOW_DOWN_NAME in levels:
        raise ConfigurationError(f"{SLOW_DOWN_NAME} is not for pairs: sweep it alone")
    requested = pair if isinstance(pair, Mapping) else {}
    chosen = {name: at if requested.get(name) is not None else _spread(at) for name, at in levels.items()}
    rows, columns = sorted(chosen, key=list(specs).index)
    return Grid(rows, columns, chosen[rows], chosen[columns])


def _spread(levels: Sequence[float]) -> list[float]:
    """Return the neutral level, and `NUM_LEVELS` that are spread over the others, the strongest included."""
    last = len(levels) - 1
    return [levels[i] for i in sorted({round(k * last / NUM_LEVELS) for k in range(NUM_LEVELS + 1)})]

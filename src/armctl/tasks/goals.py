"""Goals of tasks: what hindsight needs to know in order to give a transition another goal."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array


@dataclass(frozen=True)
class Goals:
    """Achieved and desired goals as functions of the state of n worlds, and where the observation tells the latter."""

    achieved: Callable[[Any], Array]
    """Function of the state: what is achieved, (n, k). It may be more than places, such as whether things are at rest.
    """
    desired: Callable[[Any], Array]
    """Function of the state: what is to be achieved, (n, k)."""
    reached: Callable[[Array, Array], NDArray[np.bool_]]
    """Function of achieved and desired goals (n, k): whether the task is done, (n,), as the task itself judges."""
    part: str
    """Part of the observation that begins with the first `size` numbers of the desired goal."""
    size: int

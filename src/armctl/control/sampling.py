"""Model predictive control by sampling: draw action sequences around the last plan, roll them out, and combine them.

One family, which differs in how the costs of the candidates make a plan:

- `predictive`: the cheapest (predictive sampling; Howell et al., "Predictive sampling: real-time behaviour synthesis
  with MuJoCo", arXiv:2212.00541, 2022);
- `mppi`: a mean with weights exp(-cost / temperature) (model predictive path integral control; Williams et al.,
  "Information theoretic MPC for model-based reinforcement learning", ICRA 2017);
- `cem`: the mean of the elites, whose spread is that of the next iteration (cross-entropy method; Kobilarov, "Cross-
  entropy motion planning", IJRR 31(7), 2012).

The noise is smooth: a spline through a few knots. The rollout is a function, of any model.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field
from scipy.interpolate import make_interp_spline

from armctl.core.arrays import Array
from armctl.core.errors import ConfigurationError
from armctl.core.options import Count, Positive, options

CUBIC = 3
"""Degree of the splines; less where they have too few knots."""

NO_GUESSES = np.zeros((0, 1, 1))

State = TypeVar("State")
Rollout = Callable[[State, Array], Array]
"""Costs (n,) of action sequences (n, horizon, dim) from a state."""


@options
class SamplingOptions:
    """Options of `SamplingMpc`."""

    method: Literal["mppi", "predictive", "cem"] = "mppi"
    samples: Count = 64
    """Candidates of an iteration."""
    horizon: Count = 20
    """Periods of a plan."""
    knots: Count = 4
    """Knots of the noise's splines, evenly spaced over the horizon."""
    noise: Positive = 0.5
    """Standard deviation of the noise at a knot, in the unit of each action."""
    finest: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Factor of the noise of the last candidate. From the first one, whose factor is 1, it falls by geometric steps, so
    that candidates explore and refine. With `cem`, all have the factor 1, and instead no knot's deviation falls below
    this share of `noise`."""
    temperature: Positive = 0.1
    """Temperature of `mppi`, in standard deviations of the candidates' costs, as in Xue et al., "Full-order sampling-
    based MPC for torque-level locomotion control via diffusion-style annealing", ICRA 2025: the unit of the costs does
    not matter."""
    elites: Count = 8
    """Number of cheapest candidates whose mean `cem` takes."""
    iterations: Count = 1
    """Iterations per plan."""


@dataclass(frozen=True, eq=False)
class SampledPlan:
    """A plan, and what it costs by the rollout."""

    actions: Array
    """(horizon, dim)."""
    cost: float
    """Infinite if no candidate had a finite cost: then the actions are the last plan's."""


class SamplingMpc(Generic[State]):
    """Plans actions between `lower` and `upper` (dim,) by sampling, from one control step to the next.

    `unit` (dim,) is the unit of each action's noise. Raises `ConfigurationError` for bounds that do not fit.
    """

    def __init__(
        self, rollout: Rollout[State], lower: ArrayLike, upper: ArrayLike, options: SamplingOptions, unit: ArrayLike = 1
    ) -> None:
        self.options, self._rollout = options, rollout
        self.lower, self.upper = np.atleast_1d(lower).astype(float), np.atleast_1d(upper).astype(float)
        if self.lower.ndim != 1 or self.lower.shape != self.upper.shape or not (self.lower <= self.upper).all():
            raise ConfigurationError(
                f"bounds of actions are two arrays (dim,), lower <= upper, not {lower!r}, {upper!r}"
            )
        knots = min(options.knots, options.horizon)
        self._places = np.round(np.linspace(0, options.horizon - 1, knots)).astype(int)
        self._splines = _splines(self._places, options.horizon)
        self._noise = np.full((knots, len(self.lower)), options.noise) * np.broadcast_to(unit, self.lower.shape)
        last = 1.0 if options.method == "cem" else options.finest
        self._scales = np.geomspace(1.0, last, options.samples)[:, None, None]
        self.failures = 0
        """Plans for which no candidate had a finite cost."""
        self.reset(np.zeros(len(self.lower)))

    def reset(self, idle: ArrayLike) -> None:
        """Forget the plan, for a new episode; `idle` (dim,) is the first guess of all actions."""
        self.actions = np.tile(np.clip(idle, self.lower, self.upper), (self.options.horizon, 1))
        """Last plan (horizon, dim)."""

    def plan(self, state: State, rng: np.random.Generator, guesses: Array = NO_GUESSES) -> SampledPlan:
        """Plan from a state. The plan costs at most as much as the last one, a period later, and each of the guesses.

        `guesses` (k, horizon, dim) are further candidates of the first iteration; (k, 1, dim) are held.
        """
        others = np.clip(np.broadcast_to(guesses, (len(guesses), *self.actions.shape)), self.lower, self.upper)
        mean, noise, cost = np.concatenate((self.actions[1:], self.actions[-1:])), self._noise, np.inf
        for _ in range(self.options.iterations):
            draws = self._scales * rng.standard_normal((self.options.samples, *noise.shape)) * noise
            candidates = np.clip(mean + self._splines @ draws, self.lower, self.upper)
            candidates[0] = mean
            candidates = np.concatenate((candidates, others))
            costs = self._costs(state, candidates)
            best, others = int(costs.argmin()), others[:0]
            if not np.isfinite(costs[best]):
                break
            mean, cost = candidates[best], float(costs[best])
            if self.options.method == "predictive":
                continue
            combined, noise = self._combined(candidates, costs)
            if (combined_cost := float(self._costs(state, combined[None])[0])) <= cost:
                mean, cost = combined, combined_cost
        self.failures += not np.isfinite(cost)
        self.actions = mean
        return SampledPlan(mean.copy(), cost)

    def _costs(self, state: State, candidates: Array) -> Array:
        """Return the costs (n,); infinite ones in place of those that are no numbers."""
        costs = np.asarray(self._rollout(state, candidates), dtype=float)
        return np.where(np.isnan(costs), np.inf, costs)

    def _combined(self, candidates: Array, costs: Array) -> tuple[Array, Array]:
        """Return the mean (horizon, dim) of weighted candidates, and the noise (knots, dim) of the next iteration."""
        if self.options.method == "mppi":
            return np.tensordot(path_integral_weights(costs, self.options.temperature), candidates, 1), self._noise
        elites = candidates[np.argsort(costs, kind="stable")[: self.options.elites]]
        return elites.mean(axis=0), np.maximum(elites[:, self._places].std(axis=0), self.options.finest * self._noise)


def path_integral_weights(costs: Array, temperature: float) -> Array:
    """Return weights (n,) exp(-cost / (temperature times the costs' standard deviation)), whose sum is 1.

    Infinite costs weigh nothing; at least one has to be finite.
    """
    finite = costs[np.isfinite(costs)]
    spread = max(temperature * float(finite.std()), np.finfo(float).tiny)
    weights = np.exp(-np.minimum((costs - finite.min()) / spread, 700.0)) * np.isfinite(costs)
    return np.asarray(weights / weights.sum())


def _splines(places: NDArray[np.int64], horizon: int) -> Array:
    """Return the weights (horizon, knots) of knots in the values of a spline through them."""
    if len(places) == 1:
        return np.ones((horizon, 1))
    spline = make_interp_spline(places, np.eye(len(places)), k=min(CUBIC, len(places) - 1))
    return np.asarray(spline(np.arange(horizon)))

"""Facts about a cell besides its episodes and runs. The three are stored; everything else is computed from them."""

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from pydantic import Field
from typing_extensions import TypedDict

from armctl.agents.costs import TrainingCost
from armctl.core.kinds import Kind, kind_of

Finite = Annotated[float, Field(allow_inf_nan=False)]
UNDECLARED: Literal["not declared"] = "not declared"
"""Text in place of what nobody said about a policy."""


class RealTimeFacts(TypedDict):
    """Real time of a cell: the `latency` is `measured`, or the folder of the recorded times."""

    latency: str
    slow_down: Finite


@dataclass(frozen=True)
class PolicyFacts:
    """Facts about a policy besides its episodes."""

    sees: str
    training_cost: TrainingCost
    construction_ms: Finite | None
    """None if unknown."""
    spared: tuple[str, ...]
    """The disturbances that do not reach it."""
    family: str | None = None
    """Kind of method, such as `MPC`; None: it declares none."""
    foresight: tuple[str, ...] = ()
    """Foresight that it declares, of what this environment has: keys of `FORESIGHT`."""
    kind: Kind | Literal["not declared"] | None = None
    """Kind of policy as it was declared; None: it is learned if it was trained, or else classical."""
    interface: dict[str, str] = field(default_factory=dict)
    """Values of the options by which it saw and commanded the robot, and `frames`, the observations at a time."""
    isolated: bool = False
    """True if it played in a process of its own, which got observations only."""
    transport_ms: Finite | None = None
    """Time that messages take beside a decision, median; None if that was not measured."""

    @property
    def side(self) -> Kind:
        """Kind on which verdicts count it."""
        return kind_of(self.kind, self.training_cost.steps > 0)


def training_cost_of(policy: Any) -> TrainingCost:
    """Return the cost of a policy's training: its steps are decisions, unless its card says otherwise."""
    steps, minutes = policy.training_steps, getattr(policy, "training_minutes", None)
    cost = getattr(policy, "training_cost", None)
    return cost if isinstance(cost, TrainingCost) else TrainingCost(steps, minutes, steps or None)


@dataclass(frozen=True, kw_only=True)
class Facts:
    """Facts about a cell besides its episodes and runs."""

    env_options: dict[str, str]
    policy_seed: Annotated[int, Field(ge=0, lt=2**128)]
    """Secret from which policies drew their own random numbers."""
    planned: Annotated[int, Field(ge=1, le=2**62)]
    """Number of episodes that were asked for."""
    policies: dict[str, PolicyFacts]
    return_bounds: tuple[Finite, Finite] | None
    time_limit: Annotated[int, Field(ge=1, le=2**31)] | None
    """Largest number of control steps of an episode; None if unknown."""
    control_period: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None
    versions: dict[str, str]
    machine: dict[str, Any]
    notes: list[str]
    """Remarks that do not follow from the episodes."""
    failures: dict[str, str]
    """Error messages: by policy, under `results` if results could not be written, or under `workers`."""
    baseline: str | None
    """The policy that all others are held against, if one was chosen beforehand."""
    margin: Annotated[float, Field(gt=0, lt=1)]
    """Difference in success below which policies count as equivalent."""
    real_time: RealTimeFacts | None
    """None if the world waited for decisions."""
    groups: dict[str, list[str]]
    """The trainings that count as one learner: their names in the episodes, by the group's name."""
    disqualified: list[str]
    """Policies that wrote to the world, so that none of their episodes count."""
    interrupted: bool
    resumed: int
    """Number of episodes that an earlier run had finished."""
    at_most: Annotated[int, Field(ge=1, le=2**62)] | None = None
    """Largest number of episodes of a comparison that stops when it is decided; None: their number was fixed."""
    first_episode: Annotated[int, Field(ge=0, le=2**62)] = 0
    """Number of the first episode that was asked for."""
    paired: bool = True
    """True if all policies played the same episodes."""
    sources: list[str] = field(default_factory=list)
    """Files in which episodes that were played elsewhere were found; empty if armctl played them."""
    unknown: list[str] = field(default_factory=list)
    """Measures that these files do not have: of `return`, `steps` and `decision_ms`."""

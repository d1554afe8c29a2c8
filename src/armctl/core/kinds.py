"""Kinds of policies, which verdicts, reports and suites hold against each other."""

from typing import Any, Literal, get_args

from armctl.core.errors import unknown_name

Kind = Literal["classical", "learned", "hybrid"]
KINDS: tuple[Kind, ...] = get_args(Kind)
"""A `classical` policy plans or controls by a model, a `learned` one acts by a network, a `hybrid` does both."""


def check_kind(kind: object) -> None:
    """Raise `ConfigurationError` for what is not in `KINDS`."""
    if kind not in KINDS:
        raise unknown_name("kind", kind, KINDS)


def kind_of(declared: str | None, is_trained: bool) -> Kind:
    """Return the kind on which verdicts count a policy: the declared one; or else learned if it was trained."""
    return next((kind for kind in KINDS if kind == declared), KINDS[is_trained])


def declared_kind(policy: Any) -> Kind | None:
    """Return the kind that a policy, or its maker, declares; None without a declaration."""
    kind = getattr(policy, "kind", None)
    return kind if kind in KINDS else None

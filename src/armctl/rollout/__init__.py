"""Policies play episodes: the loop, its recorder, decision times, latency."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.rollout.loop import evaluate, rollouts

__all__ = ["evaluate", "rollouts"]

__getattr__, __dir__ = on_first_use(__name__)

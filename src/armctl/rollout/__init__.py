"""Policies play episodes: the loop, its recorder, decision times, latency."""

from armctl.rollout.rollouts import evaluate, rollouts

__all__ = ["evaluate", "rollouts"]

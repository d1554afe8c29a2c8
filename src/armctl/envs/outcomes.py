"""Outcomes that an episode of any environment may have, besides those of its task."""

ERROR = "error"
"""The outcome of an episode in which the policy failed: it raised an error, or returned an invalid action. It is a loss
(see `armctl.rollout.loop`)."""
UNSTABLE = "unstable"
"""The outcome of an episode whose physics has failed (see `armctl.simulation.Simulation.unstable`)."""

"""Trainings in experiment trackers, such as Weights & Biases: configuration, learning curve, video and agent.

A package offers trackers, subclasses of `Tracker`, under the entry-point group `armctl.trackers`.
"""

from armctl.integrations.tracking.following import tracked
from armctl.integrations.tracking.tracker import Ending, Tracker, load_tracker, tracker_names

__all__ = ["Ending", "Tracker", "load_tracker", "tracked", "tracker_names"]

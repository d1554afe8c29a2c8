"""Episodes: the result of one, the table of many, and the folder that stores them."""

from armctl.episodes.failures import PolicyFailed
from armctl.episodes.record import EpisodeResult

__all__ = ["EpisodeResult", "PolicyFailed"]

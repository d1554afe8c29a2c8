"""Episodes: the result of one, the table of many, and the folder that stores them."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.episodes.failures import PolicyFailed
    from armctl.episodes.record import EpisodeResult

__all__ = ["EpisodeResult", "PolicyFailed"]

__getattr__, __dir__ = on_first_use(__name__)

"""Results made anywhere: `judge` reads them, and `log` records trials of a real robot by hand."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.judging.verb import judge

__all__ = ["judge"]

__getattr__, __dir__ = on_first_use(__name__)

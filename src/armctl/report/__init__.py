"""The report of a comparison: one HTML file that works offline, on a phone and in print."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.report.page import write_report

__all__ = ["write_report"]

__getattr__, __dir__ = on_first_use(__name__)

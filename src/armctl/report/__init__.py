"""The report of a comparison: one HTML file that works offline, on a phone and in print."""

from armctl.report.page import write_report

__all__ = ["write_report"]

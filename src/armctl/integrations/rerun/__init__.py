"""Recordings of episodes for Rerun's viewer."""

from armctl.integrations.rerun.recording import RerunLog, rerun_opener

__all__ = ["RerunLog", "rerun_opener"]

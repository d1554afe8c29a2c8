"""Controllers that follow what a planner found. Nothing here knows of MuJoCo or Gymnasium."""

from armctl.control.pursuit import PursuitOptions, RegulatedPurePursuit

__all__ = ["PursuitOptions", "RegulatedPurePursuit"]

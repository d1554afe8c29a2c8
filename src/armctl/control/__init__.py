"""Controllers: path following, model predictive control, motions in time. Nothing here knows of MuJoCo or Gymnasium."""

from armctl.control.pursuit import PursuitOptions, RegulatedPurePursuit

__all__ = ["PursuitOptions", "RegulatedPurePursuit"]

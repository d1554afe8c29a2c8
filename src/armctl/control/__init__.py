"""Path following, model predictive control and trajectory timing, independent of MuJoCo and Gymnasium."""

from armctl.control.pursuit import PursuitOptions, RegulatedPurePursuit

__all__ = ["PursuitOptions", "RegulatedPurePursuit"]

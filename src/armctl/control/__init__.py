"""Path following, model predictive control and trajectory timing, independent of MuJoCo and Gymnasium."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.control.pursuit import PursuitOptions, RegulatedPurePursuit
    from armctl.control.reach_mpc import ReachMpc

__all__ = ["PursuitOptions", "ReachMpc", "RegulatedPurePursuit"]

__getattr__, __dir__ = on_first_use(__name__)

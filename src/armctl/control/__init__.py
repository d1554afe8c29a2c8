"""Path following, model predictive control, trajectory timing, set-points of real arms; without simulator."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.control.pursuit import PursuitOptions, RegulatedPurePursuit
    from armctl.control.reach import ReachController, ReachControllerOptions, SetPoint, State
    from armctl.control.reach_mpc import ReachMpc

__all__ = [
    "PursuitOptions",
    "ReachController",
    "ReachControllerOptions",
    "ReachMpc",
    "RegulatedPurePursuit",
    "SetPoint",
    "State",
]

__getattr__, __dir__ = on_first_use(__name__)

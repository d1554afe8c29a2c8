"""Bridge crossing: a rover drives to the far end of a bridge without touching anything."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.tasks.bridge.barn import BarnOptions, BarnTask
    from armctl.tasks.bridge.barn_moving import BarnMovingOptions, BarnMovingTask
    from armctl.tasks.bridge.bridge import BridgeMovingTask, BridgeOutcome, BridgeTask
    from armctl.tasks.bridge.options import CONTROL_PERIOD, BridgeMovingOptions, BridgeOptions
    from armctl.tasks.bridge.state import REWARD, BridgeState

__all__ = [
    "CONTROL_PERIOD", "REWARD", "BarnMovingOptions", "BarnMovingTask", "BarnOptions", "BarnTask", "BridgeMovingOptions",
    "BridgeMovingTask", "BridgeOptions", "BridgeOutcome", "BridgeState", "BridgeTask",
]  # fmt: skip

__getattr__, __dir__ = on_first_use(__name__)

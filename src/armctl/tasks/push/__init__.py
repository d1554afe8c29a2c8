"""Push: bring an object to a target on a table by a straight tool."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.tasks.push.options import PushOptions
    from armctl.tasks.push.push import PushOutcome, PushTask
    from armctl.tasks.push.state import PushState

__all__ = ["PushOptions", "PushOutcome", "PushState", "PushTask"]

__getattr__, __dir__ = on_first_use(__name__)

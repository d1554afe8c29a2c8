"""Causes of errors in other people's code that their messages do not name."""

import sys
import traceback
from pathlib import Path
from types import FrameType

ON_OLDER_MUJOCO = (
    ". MuJoCo is {version} here, and this code may be for an older one: play it by another Python that has that, "
    "python=INTERPRETER:MODULE:NAME"
)
ENUM = "mjt"
"""Prefix of MuJoCo's enumerations: NumPy's integers are not among their values since MuJoCo 4."""
ARRAYS = ("model.", "data.")
"""Beginnings of arrays in MuJoCo's structures, whose shapes differ between versions."""


def source_line(error: BaseException) -> str:
    """Return the line of code that raised an error without a text, and its file; empty if it is unknown."""
    summary = traceback.extract_tb(error.__traceback__)[-1:]
    if not summary or not summary[0].line:
        return ""
    return f'"{_first_line(summary[0])}" in {Path(summary[0].filename).name}:{summary[0].lineno}'


def hint_for(error: BaseException) -> str:
    """Return a hint at another version of MuJoCo if an error looks like its consequence; else nothing."""
    mujoco = sys.modules.get("mujoco")
    if mujoco is None or not _is_of_mujoco(error):
        return ""
    return ON_OLDER_MUJOCO.format(version=mujoco.__version__)


def _is_of_mujoco(error: BaseException) -> bool:
    if isinstance(error, AttributeError):
        source = error.obj
        kind = source if isinstance(source, type) else type(source)
        return "mujoco" in (getattr(source, "__name__", ""), kind.__module__.partition(".")[0])
    if isinstance(error, ImportError):
        return (error.name or "").partition(".")[0] == "mujoco"
    frame = _innermost(error)
    if frame is None or "mujoco" not in frame.f_globals:
        return False
    line = _first_line(traceback.extract_tb(error.__traceback__)[-1])
    is_shape = isinstance(error, (ValueError, IndexError, TypeError)) and "site-packages" in frame.f_code.co_filename
    return ENUM in line or (is_shape and any(array in line for array in ARRAYS))


def _innermost(error: BaseException) -> FrameType | None:
    frames = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    return frames[-1] if frames else None


def _first_line(summary: traceback.FrameSummary) -> str:
    return (summary.line or "").partition("\n")[0].strip()

"""Expands xacro files by the package xacrodoc, in a process of its own with a time limit: they are programs."""

import importlib.util
import subprocess
import sys
from pathlib import Path

from armctl.core.errors import ConfigurationError
from armctl.robot_description.xml_file import MAX_BYTES, needs_xacro

TIME_LIMIT = 60
"""s: the largest xacro files of the benchmark's arms take 2."""
EXPAND = """
import sys
from xacrodoc import XacroDoc
document = XacroDoc.from_file(sys.argv[1], resolve_packages=False)
sys.stdout.buffer.write(document.to_urdf_string().encode())
"""


def expanded(path: Path) -> bytes:
    """Return the URDF that a xacro file describes; packages are looked for in the folders above it.

    Raises `ConfigurationError` if xacrodoc is not installed, or cannot expand the file in `TIME_LIMIT`.
    """
    if importlib.util.find_spec("xacrodoc") is None:
        raise ConfigurationError(needs_xacro(path, path.suffix))
    command = [sys.executable, "-c", EXPAND, str(path)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=TIME_LIMIT, cwd=path.parent, check=False)
    except subprocess.TimeoutExpired as error:
        raise ConfigurationError(f"xacrodoc did not expand {path.name} within {TIME_LIMIT} s") from error
    if done.returncode:
        lines = done.stderr.decode(errors="replace").strip().splitlines() or ["it gave no reason"]
        raise ConfigurationError(f"xacrodoc cannot expand {path.name}: {lines[-1][:200]}")
    if len(done.stdout) > MAX_BYTES:
        raise ConfigurationError(f"{path.name} expands to more than {MAX_BYTES} bytes")
    return done.stdout

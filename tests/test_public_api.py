"""The public interface: what `armctl` and its packages offer by name, with signatures. A change of it is on purpose.

python tests/test_public_api.py    # writes public_api.txt anew; say what changed in CHANGELOG.md
"""

import importlib
import inspect
from pathlib import Path

import armctl

SNAPSHOT = Path(__file__).with_name("public_api.txt")
PACKAGES = sorted(
    f"armctl.{path.parent.name}"
    for path in Path(armctl.__file__).parent.glob("*/__init__.py")
    if "__all__" in path.read_text() and path.parent.name != "cli"
)


def interface():
    """A line for each public name: those of `armctl` with their signatures, those of packages by name."""
    lines = [f"armctl.{name}{_signature(getattr(armctl, name))}" for name in armctl.__all__]
    for package in PACKAGES:
        lines += [f"{package}.{name}" for name in importlib.import_module(package).__all__]
    return "".join(f"{line}\n" for line in lines)


def _signature(value):
    if isinstance(value, type):
        methods = (name for name in vars(value) if not name.startswith("_"))
        return f": {', '.join(sorted(methods))}"
    parameters = inspect.signature(value).parameters.values()
    return f"({', '.join(str(one.replace(annotation=one.empty)) for one in parameters)})"


def test_the_public_interface_is_the_recorded_one():
    assert interface() == SNAPSHOT.read_text()


if __name__ == "__main__":
    SNAPSHOT.write_text(interface())

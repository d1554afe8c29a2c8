"""The public interface: what `armctl` and its packages offer by name, with signatures. A change of it is on purpose.

python tests/test_public_api.py    # writes public_api.txt anew; say what changed in CHANGELOG.md
"""

import importlib
import inspect
import typing
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
    return f"({', '.join(map(_parameter, inspect.signature(value).parameters.values()))})"


def _parameter(parameter):
    if typing.get_origin(parameter.annotation) is not typing.Unpack:
        return str(parameter.replace(annotation=parameter.empty))
    (options,) = typing.get_args(parameter.annotation)
    return f"**{{{', '.join(options.__annotations__)}}}"


def test_the_public_interface_is_the_recorded_one():
    assert interface() == SNAPSHOT.read_text()


if __name__ == "__main__":
    SNAPSHOT.write_text(interface())

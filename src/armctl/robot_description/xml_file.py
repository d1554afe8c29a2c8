"""Reads the XML of robot files, URDF, SRDF and MJCF, within limits: such a file may come from a stranger."""

import reprlib
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from xml.parsers import expat

from armctl.core.errors import ConfigurationError, reason
from armctl.core.files import bounded_bytes

Element = ElementTree.Element

MAX_BYTES = 5_000_000
"""Size of a file; the largest of example-robot-data has 0.2 MB."""
MAX_DEPTH = 100
"""Elements within each other; URDF itself needs 5, and simulators add some of their own; MJCF nests links."""


def read_xml(path: Path, content: bytes | None = None, roots: tuple[str, ...] = ("robot",)) -> Element:
    """Return the root element of a file, one of `roots`, or of the `content` that a program made of it.

    Raises `ConfigurationError` for another root, for what is no XML, and for what is beyond the limits.
    """
    try:
        root = _parsed(path.name, bounded_bytes(path, MAX_BYTES) if content is None else content)
        if root.tag == "robot" and (leftover := _of_xacro(root)):
            raise ConfigurationError(needs_xacro(path, leftover))
    except (ElementTree.ParseError, expat.ExpatError) as error:
        raise ConfigurationError(f"{path.name} cannot be read as XML: {error}") from error
    except (OSError, ValueError, LookupError) as error:
        if isinstance(error, ConfigurationError):
            raise
        raise ConfigurationError(f"{path.name} cannot be read as XML: {reason(error)}") from error
    if root.tag not in roots:
        formats = " or ".join(f"<{tag}>" for tag in roots)
        raise ConfigurationError(
            f"{path.name} is not a {'URDF or MJCF' if len(roots) > 1 else 'URDF or SRDF'}: its root element is "
            f"<{root.tag[:40]}>, not {formats}"
        )
    return root


def _parsed(name: str, content: bytes) -> Element:
    """Return the root element; prefixes that no `xmlns` declares, which ROS allows, are part of the names."""
    try:
        return ElementTree.fromstring(content, ElementTree.XMLParser(target=_Limited(name)))
    except ElementTree.ParseError as error:
        if "unbound prefix" not in str(error):
            raise
    builder, parser = _Limited(name), expat.ParserCreate()
    parser.StartDoctypeDeclHandler, parser.CharacterDataHandler = builder.doctype, builder.data
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.Parse(content, True)
    return builder.close()


def needs_xacro(path: Path, leftover: str) -> str:
    """Return why a xacro file is refused, and what helps."""
    return (
        f"{path.name} is a xacro file, or has leftovers of one ({leftover}): expand it first, `xacro arm.urdf.xacro > "
        "arm.urdf`; without ROS, `pip install xacrodoc` and `xacrodoc arm.urdf.xacro -o arm.urdf`"
    )


def short(text: str, length: int = 30) -> str:
    """Return a text from a file as messages show it: quoted, and not too long."""
    shortened = reprlib.Repr()
    shortened.maxstring = length
    return shortened.repr(text)


def _of_xacro(root: Element) -> str | None:
    """Return an element or an expression of xacro's in a file, if there is one in what is read."""
    spaces = (element.tag.rpartition("}") for element in root.iter())
    if name := next((name for space, _, name in spaces if "xacro" in space or name.startswith("xacro:")), None):
        return f"<xacro:{name[:40]}>"
    parts = [part for part in root if part.tag in ("link", "joint")]
    values = (value for part in parts for element in part.iter() for value in element.attrib.values())
    return next((short(value) for value in values if "${" in value or "$(" in value), None)


def impossible_pairs(srdf: Path) -> set[frozenset[str]]:
    """Return pairs of links that cannot touch, according to an SRDF."""
    pairs = read_xml(srdf).iter("disable_collisions")
    return {frozenset((pair.get("link1", ""), pair.get("link2", ""))) for pair in pairs}


class _Limited(ElementTree.TreeBuilder):
    """Refuses deep nesting, on which libraries overflow their stacks, and document types, which define entities."""

    def __init__(self, name: str) -> None:
        super().__init__()
        self._name, self._depth = name, 0

    def doctype(self, *_: object) -> None:
        raise ConfigurationError(f"{self._name} has a document type (<!DOCTYPE>), which armctl does not read")

    def start(self, tag: str, attrs: dict[str, str]) -> Element:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise ConfigurationError(f"{self._name} has more than {MAX_DEPTH} elements within each other")
        return super().start(tag, attrs)

    def end(self, tag: str) -> Element:
        self._depth -= 1
        return super().end(tag)

"""Finds and reads the meshes of a URDF, only those below its own package: a URDF may come from a stranger."""

import re
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import coal
import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array

FORMATS = (".stl", ".dae", ".obj", ".ply")
"""Formats that hold all of a mesh in one file."""
MAX_BYTES = 64_000_000
"""Size of all mesh files of a robot together; the largest in example-robot-data has 29 MB."""
MAX_DEPTH = 64
"""Elements within each other in a `.dae`, which the library reads by recursion."""
LARGEST = 1e6
"""m: largest coordinate."""
THINNEST = 1e-6
"""m: least thickness; MuJoCo cannot compute the inertia of a flat mesh."""
SMALLEST = 1e-12
"""m^3: least volume of a box around it; nor can it that of a tiny one."""
_NUMBER = re.compile(rb"[-+]?[\d.]+(?:[eE][-+]?\d+)?|[-+]?(?:nan|inf|infinity)", re.IGNORECASE)


class MeshError(ValueError):
    """Problem with a mesh."""


class Meshes:
    """The meshes of one URDF.

    The package of a URDF is the nearest folder above it with a `package.xml`; or else the folder that holds its folder
    `urdf` or `robots`; or else its own folder. Besides, every URDF may use the packages in `shared`.
    """

    def __init__(self, urdf: Path, shared: Path) -> None:
        self._folder, self._shared = urdf.resolve().parent, shared
        parents = (self._folder, *self._folder.parents)
        named = self._folder.parent if self._folder.name in ("urdf", "robots") else self._folder
        self.package = next((folder for folder in parents if (folder / "package.xml").is_file()), named)
        self._bytes_left = MAX_BYTES

    def read(self, filename: str, scale: Array) -> tuple[Array, NDArray[np.int32]]:
        """Return vertices (k, 3) m and triangles (m, 3) of a mesh, as a URDF names it. Raises `MeshError`."""
        path = self._find(filename)
        if path.suffix.lower() not in FORMATS:
            raise MeshError(f"is no mesh of a format that armctl reads: {', '.join(FORMATS)}")
        with path.open("rb") as file:
            content = file.read(self._bytes_left + 1)
        if len(content) > self._bytes_left:
            raise MeshError(f"is too large: the meshes of a robot may have {MAX_BYTES / 1e6:g} MB together")
        self._bytes_left -= len(content)
        vertices, triangles = _parse(path, content, scale)
        if not len(vertices) or not len(triangles):
            raise MeshError("is empty")
        if not (np.abs(vertices) <= LARGEST).all():
            raise MeshError(f"has coordinates that are not numbers, or beyond {LARGEST:g} m")
        centred = vertices - vertices.mean(axis=0)
        extent = np.ptp(centred @ np.linalg.eigh(centred.T @ centred)[1], axis=0)
        if extent.min() < THINNEST:
            raise MeshError(f"is flat: its thickness is {extent.min():.1g} m, and should be {THINNEST:g} m or more")
        if extent.prod() < SMALLEST:
            raise MeshError(f"is tiny: it is {extent.max():.1g} m long")
        return vertices, triangles

    def _find(self, filename: str) -> Path:
        name = filename.removeprefix("file://") if filename.startswith("file:///") else filename
        _, scheme, in_package = name.partition("package://")
        if scheme:
            package, _, rest = in_package.partition("/")
            candidates = [(self.package, self.package / rest), (self.package, self.package / in_package)]
            if package == self._shared.name:
                candidates.append((self._shared, self._shared / rest))
        else:
            name = name.removeprefix("file://")
            if "://" in name or name.startswith(("/", "\\")):
                raise MeshError("is named by an absolute path: name it relative to the URDF, or as package://")
            candidates = [(self.package, self._folder / name), (self.package, self.package / name)]
        try:
            for allowed, path in candidates:
                if path.is_file():
                    absolute = path.resolve()
                    if not absolute.is_relative_to(allowed.resolve()):
                        raise MeshError(f"lies outside of the URDF's package {allowed.name!r}")
                    return absolute
        except (OSError, RuntimeError) as error:  # a name too long, links that go round in circles
            raise MeshError(f"cannot be opened: {error}") from error
        raise MeshError(f"was not found in the URDF's package, the folder {self.package.name!r}")


def _parse(path: Path, content: bytes, scale: Array) -> tuple[Array, NDArray[np.int32]]:
    if path.suffix.lower() == ".dae":
        try:
            ElementTree.XMLParser(target=_Limited()).feed(content)
        except ElementTree.ParseError as error:
            raise MeshError(f"cannot be read: {error}") from error
    elif path.suffix.lower() == ".obj":
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / "mesh.obj"
            copy.write_bytes(_shape_of_obj(content))
            return _load(copy, scale)
    return _load(path, scale)


def _shape_of_obj(content: bytes) -> bytes:
    """Return vertices and faces of an `.obj` alone: other lines name files, of colours, and may have many spellings."""
    lines = []
    for line in re.split(rb"[\r\n\f\0]+", re.sub(rb"\\\r?\n", b"", content)):
        kind, *values = line.partition(b"#")[0].split() or [b""]
        if kind not in (b"v", b"f"):
            continue
        if kind == b"f":
            values = [corner.partition(b"/")[0] for corner in values]  # without texture and normal
        if not all(map(_NUMBER.fullmatch, values)):
            raise MeshError("cannot be read: a vertex or a face in it is not of numbers")
        lines.append(b" ".join((kind, *values)))
    return b"\n".join(lines) + b"\n"


def _load(path: Path, scale: Array) -> tuple[Array, NDArray[np.int32]]:
    try:
        mesh = coal.MeshLoader().load(str(path), scale)
        triangles = [[mesh.tri_indices(i)[corner] for corner in range(3)] for i in range(mesh.num_tris)]
        return np.array(mesh.vertices()).reshape(-1, 3), np.array(triangles, dtype=np.int32).reshape(-1, 3)
    except (ValueError, RuntimeError) as error:
        raise MeshError("cannot be read") from error


class _Limited:
    """Refuses what makes a `.dae` grow when it is read: entities, deep nesting, and nodes that stand for others."""

    def __init__(self) -> None:
        self._depth = 0

    def doctype(self, *_: object) -> None:
        raise MeshError("has a document type (<!DOCTYPE>), which armctl does not read")

    def start(self, tag: str, _: dict[str, str]) -> None:
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise MeshError(f"has more than {MAX_DEPTH} elements within each other")
        if tag.rpartition("}")[2] == "instance_node":
            raise MeshError("has <instance_node>, which armctl does not read")

    def end(self, _: str) -> None:
        self._depth -= 1

    def close(self) -> None:
        """Do nothing: nothing is built."""

"""Finds and reads the meshes of a URDF, only those below its own package: a URDF may come from a stranger."""

import itertools
import math
import re
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

import coal
import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Array
from armctl.core.errors import reason
from armctl.robot_description.collada import read_collada
from armctl.robot_description.gltf import read_glb
from armctl.robot_description.xml_file import short

PATH = 80
"""Characters of a path that a message shows."""
ROBOT_FOLDERS = "mjcf", "urdf", "robots"
"""Folders of robots' files, or of a folder for each robot, beside which their meshes are."""
FORMATS = (".stl", ".dae", ".obj", ".ply", ".glb")
"""Formats that hold all of a mesh in one file."""
MAX_BYTES = 64_000_000
"""Size of all mesh files of a robot together; the largest in example-robot-data has 29 MB."""
MAX_DEPTH = 64
"""Elements within each other in a `.dae`, which the library reads by recursion."""
UNIT_DEPTH = 3
"""Depth of a `.dae`'s unit of length, in the asset of its root."""
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
    `urdf`, `robots` or `mjcf`, or that of its own folder; or else its own folder. Besides, every URDF may use the
    packages in `shared`.
    """

    def __init__(self, urdf: Path, shared: Path) -> None:
        self._folder, self._shared = urdf.resolve().parent, shared
        parents = (self._folder, *self._folder.parents)
        packages = (folder for folder in parents if (folder / "package.xml").is_file())
        folders = (folder.parent for folder in parents[:2] if folder.name in ROBOT_FOLDERS)
        self.package = next(itertools.chain(packages, folders), self._folder)
        self._bytes_left = MAX_BYTES
        self._contents: dict[Path, bytes] = {}

    def read(self, filename: str, scale: Array) -> tuple[Array, NDArray[np.int32]]:
        """Return vertices (k, 3) m and triangles (m, 3) of a mesh, as a URDF names it. Raises `MeshError`."""
        path = self._find(filename)
        if path.suffix.lower() not in FORMATS:
            formats = ", ".join(FORMATS)
            raise MeshError(
                f"is no mesh of a format that armctl reads: export it from Blender or MeshLab as one of {formats}"
            )
        content = self._content(path)
        vertices, triangles = _parse(path, content, scale)
        if not len(vertices) or not len(triangles):
            raise MeshError("is empty")
        if not (np.abs(vertices) <= LARGEST).all():
            raise MeshError(f"has coordinates that are not numbers, or beyond {LARGEST:g} m")
        if problem := thinness(vertices):
            raise MeshError(problem)
        corners = (vertices - vertices.mean(axis=0))[triangles]
        inside_out = np.linalg.det(corners).sum() < 0  # mirrored by its scale, or by a node of its file
        return vertices, triangles[:, ::-1] if inside_out else triangles

    def content(self, filename: str) -> tuple[bytes, str]:
        """Return the content of a mesh, and the suffix of its file. Raises `MeshError`."""
        path = self._find(filename)
        if path not in self._contents:
            self._contents[path] = self._content(path)
        return self._contents[path], path.suffix.lower()

    def _content(self, path: Path) -> bytes:
        with path.open("rb") as file:
            content = file.read(self._bytes_left + 1)
        if len(content) > self._bytes_left:
            raise MeshError(f"is too large: the meshes of a robot may have {MAX_BYTES / 1e6:g} MB together")
        self._bytes_left -= len(content)
        return content

    def _find(self, filename: str) -> Path:
        """Return a mesh's file, by its name as written or in another usual spelling."""
        if not filename.strip():
            raise MeshError("has no file name")
        decoded = unquote(filename)
        spellings = dict.fromkeys((filename, decoded, filename.replace("\\", "/"), decoded.replace("\\", "/")))
        candidates = [candidate for spelling in spellings for candidate in self._candidates(spelling)]
        inside = [
            (allowed, path) for allowed, path in candidates if path.is_relative_to(allowed) and ".." not in path.parts
        ]
        try:
            paths = (candidate for candidate in candidates if candidate[1].is_file())
            others = ((allowed, match) for allowed, path in inside if (match := _in_other_case(allowed, path)))
            allowed, path = next(itertools.chain(paths, others), (None, Path()))
            absolute = path.resolve()
        except (OSError, RuntimeError, ValueError) as error:  # too long, links that go round in circles, a null byte
            raise MeshError(f"cannot be opened: {reason(error)}") from error
        advice = (
            f"put it below {self.package.name!r}, change its path, or put a package.xml into a folder that holds both"
        )
        if allowed is None:
            places = dict.fromkeys(str(path.relative_to(allowed.parent)) for allowed, path in inside)
            looked = f" as {', '.join(short(place, PATH) for place in places)}" if places else ""
            package = f"the URDF's package, the folder {self.package.name!r}"
            raise MeshError(f"was not found in {package}{looked}: {advice}")
        if not absolute.is_relative_to(allowed.resolve()):
            raise MeshError(f"lies outside of the URDF's package {allowed.name!r}: {advice}")
        return absolute

    def _candidates(self, name: str) -> list[tuple[Path, Path]]:
        """Return paths at which a mesh may lie, each with the folder that has to contain it."""
        scheme, separator, rest = name.rpartition("://")
        scheme = scheme.rpartition("://")[2]
        if separator and scheme not in ("package", "model", "file"):
            raise MeshError("is at an absolute address: name it relative to the URDF, or as package://")
        if not separator or scheme == "file":
            return [(self.package, self._folder / rest), (self.package, self.package / rest)]
        package, _, inside = rest.partition("/")
        shared = [(self._shared, self._shared / inside)] if package == self._shared.name else []
        return [(self.package, self.package / inside), (self.package, self.package / rest), *shared]


def thinness(vertices: Array) -> str | None:
    """Return in which way a shape is too thin or small for MuJoCo, if it is."""
    centred = vertices - vertices.mean(axis=0)
    extent = np.ptp(centred @ np.linalg.eigh(centred.T @ centred)[1], axis=0)
    if extent.min() < THINNEST:
        return f"is flat: its thickness is {extent.min():.1g} m, and should be {THINNEST:g} m or more"
    return f"is tiny: it is {extent.max():.1g} m long" if extent.prod() < SMALLEST else None


def rings(shape: str, radius: float, half_length: float, points: int = 24) -> Iterator[tuple[float, float, float]]:
    """Return points on rings around z that enclose a shape: the two rims of a cylinder, or parallels of a sphere."""
    radius /= math.cos(math.pi / points)
    levels = [(radius, -half_length), (radius, half_length)]
    if shape == "sphere":
        levels = [(radius * math.cos(a), radius * math.sin(a)) for a in np.linspace(-np.pi / 2, np.pi / 2, points)]
    for ring_radius, z in levels:
        for angle in np.linspace(0, 2 * math.pi, points, endpoint=False):
            yield ring_radius * math.cos(angle), ring_radius * math.sin(angle), z


def round_points(shape: str, radius: float, half_length: float) -> Array:
    """Return points (k, 3) that enclose a sphere, or a cylinder or a capsule along z."""
    if shape != "capsule":
        return np.array(list(rings(shape, radius, half_length)))
    ball, end = np.array(list(rings("sphere", radius, 0.0))), np.array([0.0, 0.0, half_length])
    return np.vstack([ball - end, ball + end])


def _in_other_case(folder: Path, path: Path) -> Path | None:
    """Return the file below a folder whose path differs from this one in upper and lower case only."""
    for part in path.relative_to(folder).parts:
        names = sorted(entry.name for entry in folder.iterdir()) if folder.is_dir() else []
        match = next((name for name in names if name.casefold() == part.casefold()), None)
        if match is None:
            return None
        folder /= match
    return folder if folder.is_file() else None


def _parse(path: Path, content: bytes, scale: Array) -> tuple[Array, NDArray[np.int32]]:
    if path.suffix.lower() == ".dae":
        limited = _Limited()
        try:
            ElementTree.XMLParser(target=limited).feed(content)
        except ElementTree.ParseError as error:
            raise MeshError(f"cannot be read: {error}") from error
        try:
            vertices, triangles = read_collada(content)
        except (ArithmeticError, ElementTree.ParseError, LookupError, StopIteration, ValueError) as error:
            raise MeshError(f"cannot be read: {error}") from error
        return vertices * scale * limited.metres, triangles.astype(np.int32)
    if path.suffix.lower() == ".glb":
        try:
            vertices, triangles = read_glb(content)
        except ValueError as error:
            raise MeshError(f"cannot be read: {error}") from error
        return vertices * scale, triangles.astype(np.int32)
    if path.suffix.lower() == ".obj":
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
        triangles = [
            (triangle[0], triangle[1], triangle[2]) for triangle in map(mesh.tri_indices, range(mesh.num_tris))
        ]
        return np.array(mesh.vertices()).reshape(-1, 3), np.array(triangles, dtype=np.int32).reshape(-1, 3)
    except (ValueError, RuntimeError) as error:
        raise MeshError("cannot be read") from error


def _positive(number: str) -> float:
    """Return a positive number of a file."""
    try:
        if 0 < (value := float(number)) < LARGEST:
            return value
    except ValueError:
        pass
    raise MeshError(f"has a unit of {short(number)} m")


class _Limited:
    """Refuses what makes a `.dae` grow when it is read: entities, deep nesting, and nodes that stand for others."""

    def __init__(self) -> None:
        self._depth = 0
        self.metres = 1.0
        """The file's unit of length, m."""

    def doctype(self, *_: object) -> None:
        raise MeshError("has a document type (<!DOCTYPE>), which armctl does not read")

    def start(self, tag: str, attrs: dict[str, str]) -> None:
        self._depth += 1
        if tag.rpartition("}")[2] == "unit" and self._depth == UNIT_DEPTH:
            self.metres = _positive(attrs.get("meter", "1"))
        if self._depth > MAX_DEPTH:
            raise MeshError(f"has more than {MAX_DEPTH} elements within each other")
        if tag.rpartition("}")[2] == "instance_node":
            raise MeshError("has <instance_node>, which armctl does not read")

    def end(self, _: str) -> None:
        self._depth -= 1

    def close(self) -> None:
        """Do nothing: nothing is built."""

"""Reads the XML of an MJCF robot within limits, for MuJoCo's compiler: such a file may come from a stranger.

Included files and meshes are read here, only below the file's own package, and MuJoCo gets their content. What an arm
does not need is left out: textures, tendons, sensors, plug-ins, options of the simulation.
"""

from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree

from armctl.core.errors import ConfigurationError
from armctl.robot_description.elements import Elements
from armctl.robot_description.meshes import MeshError, Meshes
from armctl.robot_description.xml_file import Element, read_xml, short

MAX_ELEMENTS = 20_000
"""Elements of all files together; scenes of two arms have 1,000."""
MAX_FILES = 50
"""Files that a scene may include."""
SECTIONS = ("compiler", "default", "asset", "worldbody", "actuator", "keyframe", "contact")
"""Sections that are read, of all that MJCF has."""
SILENT = ("option", "size", "visual", "statistic", "sensor", "custom", "extension")
"""Sections that say nothing of the arm itself."""
KEPT = {"asset": ("mesh", "material"), "contact": ("exclude",), "keyframe": ("key",)}
"""Elements that are kept of some sections."""
BOMBS = ("replicate", "composite", "flexcomp", "attach", "plugin")
"""Elements that make many others, or read further files."""
INVISIBLE = ("light", "camera", "hfield", "texture", "layer", "skin", "flex")


@dataclass
class MjcfFile:
    """An MJCF as MuJoCo's compiler gets it."""

    root: Element
    """The tree, without includes, and with names of `assets` as the files of meshes."""
    assets: dict[str, bytes] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def text(self) -> str:
        """Return the tree as XML."""
        return ElementTree.tostring(self.root, encoding="unicode")


def read_mjcf_file(path: Path, root: Element) -> MjcfFile:
    """Return the model whose root element has been read from `path`. Raises `ConfigurationError`."""
    meshes = Meshes(path, path.parent)
    elements = Elements(path)
    root = _with_includes(root, path, meshes.package, [path])
    if (count := sum(1 for _ in root.iter())) > MAX_ELEMENTS:
        raise elements.error(f"it has {count} elements; at most {MAX_ELEMENTS} are allowed")
    if bomb := next((element.tag for element in root.iter() if element.tag in BOMBS), None):
        raise elements.error(f"it has <{bomb}>, which armctl does not read: write out what it stands for")
    folders = _mesh_folders(root)
    left_out = dict.fromkeys(part.tag for part in root if part.tag not in (*SECTIONS, *SILENT))
    for part in list(root):
        if part.tag not in SECTIONS:
            root.remove(part)
    file = MjcfFile(root)
    for part in root:
        for child in list(part):
            if part.tag in KEPT and child.tag not in KEPT[part.tag]:
                part.remove(child)
    _simplify(root)
    for mesh in root.findall("asset/mesh"):
        _read_mesh(mesh, folders, file, meshes, elements)
    if left_out:
        file.notes.append(f"Not read: {', '.join(f'<{short(tag)[1:-1]}>' for tag in left_out)}.")
    return file


def _with_includes(root: Element, main: Path, package: Path, files: list[Path]) -> Element:
    """Return a tree in which the content of included files stands for each `<include>`."""
    for parent in list(root.iter()):
        while (include := parent.find("include")) is not None:
            name = include.get("file", "")
            try:
                path = (main.parent / name).resolve()
            except (OSError, ValueError, RuntimeError) as error:
                raise ConfigurationError(f"{main.name} includes {short(name)}, which is no file") from error
            if not path.is_relative_to(package.resolve()) or not path.is_file():
                raise ConfigurationError(
                    f"{main.name} includes {short(name)}, which is no file in its package, the folder {package.name!r}"
                )
            if path in files or len(files) >= MAX_FILES:
                raise ConfigurationError(f"{main.name} includes {short(name)} twice, or more than {MAX_FILES} files")
            files.append(path)
            content = _with_includes(read_xml(path, roots=("mujoco", "mujocoinclude")), main, package, files)
            at = list(parent).index(include)
            parent.remove(include)
            for i, child in enumerate(content):
                parent.insert(at + i, child)
    return root


def _mesh_folders(root: Element) -> tuple[str, bool]:
    """Return the folder of meshes that the compiler's options state, and whether files are named without folders."""
    folder, strips = "", False
    for compiler in root.iter("compiler"):
        folder = compiler.get("meshdir", compiler.get("assetdir", folder))
        strips = compiler.get("strippath", str(strips)).lower() == "true"
        for name in ("meshdir", "assetdir", "texturedir", "strippath", "fusestatic", "discardvisual"):
            compiler.attrib.pop(name, None)
    return folder, strips


def _simplify(root: Element) -> None:
    """Remove from a tree what an arm does not need, and what depends on it."""
    for parent in list(root.iter()):
        for child in list(parent):
            is_terrain = child.tag == "geom" and child.get("type") in ("hfield", "sdf")
            is_of_tendon = parent.tag == "actuator" and "joint" not in child.attrib
            if child.tag in INVISIBLE or is_terrain or is_of_tendon:
                parent.remove(child)
    for material in root.iter("material"):
        material.attrib.pop("texture", None)
    for key in root.findall("keyframe/key"):
        for name in set(key.attrib) - {"name", "qpos"}:
            del key.attrib[name]


def _read_mesh(mesh: Element, folders: tuple[str, bool], file: MjcfFile, meshes: Meshes, elements: Elements) -> None:
    """Read the file of a `<mesh>` into `file.assets`."""
    folder, strips = folders
    name = mesh.get("file")
    if name is None:
        if "vertex" not in mesh.attrib:
            raise elements.error(f"the mesh {short(mesh.get('name', ''))} has neither a file nor vertices")
        return
    place = PurePosixPath(name.replace("\\", "/"))
    try:
        content, suffix = meshes.content(str(PurePosixPath(folder) / (place.name if strips else place)))
    except MeshError as error:
        raise elements.error(f"the mesh {short(name, 80)} {error}") from error
    mesh.attrib.setdefault("name", place.stem)
    mesh.set("file", asset := f"{len(file.assets)}{suffix}")
    mesh.attrib.pop("content_type", None)
    file.assets[asset] = content

"""Opens a robot's file: URDF, xacro or MJCF, all as the same tree of links and joints."""

from pathlib import Path

from armctl.core.errors import ConfigurationError, unknown_name
from armctl.robot_description.builtin import BUILTIN_ARMS
from armctl.robot_description.elements import Elements
from armctl.robot_description.joint_limits import Overrides
from armctl.robot_description.link_shapes import LinkShapes
from armctl.robot_description.menagerie import MENAGERIE, menagerie_file
from armctl.robot_description.meshes import Meshes
from armctl.robot_description.urdf import Urdf
from armctl.robot_description.xacro_file import expanded
from armctl.robot_description.xml_file import Element, read_xml

SUFFIXES = (".urdf", ".xml", ".xacro")


def robot_file(robot: str | Path) -> Path:
    """Return the absolute path of a robot's file. Raises `ConfigurationError` for another name, or a missing file."""
    if str(robot).startswith(MENAGERIE):
        return existing(menagerie_file(str(robot).removeprefix(MENAGERIE)))
    path = Path(robot)
    if path.suffix.lower() not in SUFFIXES:
        files = ["path/to/your.urdf", "path/to/scene.xml", f"{MENAGERIE}NAME"]
        raise unknown_name("robot", robot, [*BUILTIN_ARMS, *files])
    return existing(path)


def existing(path: Path) -> Path:
    """Return the absolute path of a file; raises `ConfigurationError` if there is none."""
    try:
        if (absolute := path.resolve()).is_file():
            return absolute
    except (OSError, ValueError, RuntimeError):
        pass  # a name that no file can have, or links that go round in circles
    raise ConfigurationError(f"there is no robot's file {str(path)!r}")


def open_robot(path: Path, tip: str | None, overrides: Overrides, shared: Path) -> Urdf:
    """Return the robot in a file; meshes may be below its own package, and below `shared`."""
    content = expanded(path) if path.suffix.lower() == ".xacro" else None
    root = read_xml(path, content, ("robot", "mujoco"))
    if root.tag == "mujoco":
        return _open_mjcf(path, root, tip, overrides)
    collisions, drawings = (LinkShapes(Elements(path), Meshes(path, shared), root) for _ in range(2))
    source = Urdf(path, root, (collisions, drawings), tip, overrides)
    if content is not None:
        source.notes.insert(0, "The xacro file was expanded by xacrodoc.")
    return source


def _open_mjcf(path: Path, root: Element, tip: str | None, overrides: Overrides) -> Urdf:
    from armctl.robot_description.mjcf import read_mjcf  # it alone needs MuJoCo

    mjcf = read_mjcf(path, root, tip)
    source = Urdf(path, mjcf.robot, (mjcf, mjcf), tip, overrides)
    source.home, source.armature, source.apart = mjcf.home, mjcf.armature, mjcf.apart
    source.notes[:0] = mjcf.notes
    return source

"""Robots of MuJoCo Menagerie by name, where a package has their files or fetches them."""

import importlib
import importlib.util
import os
from pathlib import Path

from armctl.core.errors import ConfigurationError

MENAGERIE = "menagerie:"
"""Prefix of such a robot."""


def menagerie_file(name: str) -> Path:
    """Return the file of `NAME` or `NAME/ENTRY`: its scene, or that file of the robot's folder.

    The package mujoco-menagerie fetches it once, by a checksum. Without it, a copy that robot_descriptions has made is
    taken. Raises `ConfigurationError` if there is neither, for an unknown name, and without a connection.
    """
    robot, _, entry = name.partition("/")
    if importlib.util.find_spec("mujoco_menagerie") is None:
        cache = Path(os.environ.get("ROBOT_DESCRIPTIONS_CACHE", "~/.cache/robot_descriptions")).expanduser()
        folder = cache / "mujoco_menagerie" / Path(robot).name
        if folder.is_dir():
            return folder / f"{Path(entry or 'scene').name}.xml"
        raise ConfigurationError(f"{MENAGERIE}{name} needs a package: pip install mujoco-menagerie")
    menagerie = importlib.import_module("mujoco_menagerie")
    try:
        return Path(menagerie.get(robot).xml(entry or None))
    except (menagerie.MenagerieError, OSError) as error:
        raise ConfigurationError(f"{MENAGERIE}{name} cannot be had: {str(error).splitlines()[0][:300]}") from error

"""Mutated robots: each loads, and moves as it should in Pinocchio and MuJoCo, or is refused in words."""

import copy
import itertools
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from armctl.robot_description import BUILTIN_ARMS
from armctl.robot_description.arm import robot_data

from .child import Child
from .mutation import mutated_bytes, outcomes_of

VISUAL = b'<visual><geometry><box size=".1 .1 .1"/></geometry></visual>'
UR5 = re.sub(b"<visual>.*?</visual>", VISUAL, (robot_data() / BUILTIN_ARMS["ur5"].urdf).read_bytes(), flags=re.DOTALL)
"""Drawn as boxes, which are read sooner than its meshes."""
UR5_MESH = next((robot_data() / "ur_description/meshes/ur5/collision").glob("*.stl")).read_bytes()
HOSTILE = [
    "", " ", "nan", "inf", "-inf", "1e300", "-1e300", "1e999", "1e-300", "-0", "0", "-1", "1e9", "1e-12", "1_0", "0x10",
    "1,5", "x", "0 0", "0 0 0", "0 0 0 0", "1 nan 0", "1e9 1e9 1e9", "\u0663", "../" * 30 + "etc/hostname", "/dev/zero",
    "package://", "file:///dev/zero", "base_link", "ee_link", "world", "a" * 5_000, "fixed", "revolute", "floating",
]  # fmt: skip
HERE = Path(__file__).parent


@pytest.fixture(scope="module")
def load(tmp_path_factory):
    folder, numbers = tmp_path_factory.mktemp("urdf"), itertools.count()
    child = Child(HERE / "load_urdf.py")

    def write_and_load(content, stem="ur5", **meshes):
        for name, mesh in meshes.items():
            (folder / name).write_bytes(mesh)
        path = folder / f"{stem}_{next(numbers)}.urdf"
        path.write_bytes(content)
        answer = child(path)
        path.unlink()
        return answer

    yield write_and_load
    child.close()


def mutated_tree(rng):
    """The UR5 with one to three mutations of its elements and attributes."""
    root = ElementTree.fromstring(UR5)
    for _ in range(rng.randint(1, 3)):
        parent = rng.choice([element for element in root.iter() if len(element)])
        child = rng.choice(list(parent))
        donor = rng.choice(list(root.iter()))
        match rng.randrange(6):
            case 0:
                parent.remove(child)
            case 1:
                parent.append(copy.deepcopy(child))
            case 2:
                parent.insert(rng.randrange(len(parent)), copy.deepcopy(donor))
            case _ if child.attrib:
                name = rng.choice(sorted(child.attrib))
                if rng.random() < 0.2:
                    del child.attrib[name]
                elif rng.random() < 0.5:
                    child.set(name, rng.choice(HOSTILE))
                else:
                    words = child.attrib[name].split() or [""]
                    words[rng.randrange(len(words))] = rng.choice(HOSTILE)
                    child.set(name, " ".join(words))
    return ElementTree.tostring(root)


def mutate_tree(load, rng):
    return load(mutated_tree(rng))


def mutate_bytes(load, rng):
    return load(mutated_bytes(rng, UR5))


def mutate_mesh(load, rng):
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    mesh = '<collision><geometry><mesh filename="mesh.stl"/></geometry></collision>'
    limit = '<limit lower="-1" upper="1" velocity="1" effort="9"/>'
    robot = (
        f'<robot name="r"><link name="a"/><link name="b">{inertial}{mesh}</link><joint name="j" type="revolute">'
        f'<origin xyz="0 0 1"/><parent link="a"/><child link="b"/>{limit}</joint></robot>'
    )
    return load(robot.encode(), "small", **{"mesh.stl": mutated_bytes(rng, UR5_MESH)})


@pytest.mark.slow
@pytest.mark.parametrize("mutate", [mutate_tree, mutate_bytes, mutate_mesh])
def test_a_mutated_robot_loads_or_is_refused(load, mutate):
    assert "refused" in outcomes_of(load, mutate, 15)


@pytest.mark.thorough
@pytest.mark.parametrize(("mutate", "count"), [(mutate_tree, 600), (mutate_bytes, 200), (mutate_mesh, 200)])
def test_a_thousand_mutated_robots_load_or_are_refused(load, mutate, count):
    assert outcomes_of(load, mutate, count) == {"fine", "refused"}

"""Meshes of a URDF: where they are found, what is wrong with one, and what is read of it."""

import os
import re
import shutil
import struct
import subprocess
import sys

import coal
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.robot_description import load_arm, meshes
from armctl.robot_description.arm import robot_data

from .one_joint_arm import TETRAHEDRON, arm, mesh, stl


@pytest.mark.parametrize(
    ("urdf_at", "mesh_at", "named"),
    [
        ("package/arm.urdf", "package/link.stl", "link.stl"),
        ("package/arm.urdf", "package/meshes/link.stl", "package://package/meshes/link.stl"),
        ("package/arm.urdf", "package/meshes/link.stl", "package://renamed/meshes/link.stl"),
        ("package/urdf/arm.urdf", "package/meshes/link.stl", "../meshes/link.stl"),
        ("package/urdf/arm.urdf", "package/meshes/link.stl", "package://package/meshes/link.stl"),
        ("package/robots/arm.urdf", "package/meshes/link.stl", "meshes/link.stl"),
        ("package/deep/er/arm.urdf", "package/meshes/link.stl", "package://package/meshes/link.stl"),
        ("package/arm.urdf", "package/link.stl", "file://link.stl"),
        ("package/arm.urdf", "package/link.stl", "{package}/link.stl"),
        ("package/arm.urdf", "package/link.stl", "file://{package}/link.stl"),
        ("package/urdf/arm.urdf", "package/meshes/link.stl", "{package}/meshes/link.stl"),
        ("package/arm.urdf", "package/the meshes/link 1.stl", "the meshes/link 1.stl"),
        ("package/arm.urdf", "package/the meshes/link 1.stl", "package://package/the%20meshes/link%201.stl"),
        ("package/arm.urdf", "package/100%25/link.stl", "100%25/link.stl"),
        ("package/arm.urdf", "package/meshes/link.stl", "meshes\\link.stl"),
        ("package/arm.urdf", "package/meshes/link.stl", "package://package\\meshes\\link.stl"),
        ("package/arm.urdf", "package/meshes/link.stl", "model://package/meshes/link.stl"),
        ("package/arm.urdf", "package/Meshes/Link.STL", "meshes/link.stl"),
        ("package/arm.urdf", "package/meshes/link.stl", "package://package/MESHES/LINK.STL"),
        ("package/arm.urdf", "package/meshes/link.stl", "package://package://package/meshes/link.stl"),
    ],
)
def test_meshes_are_found_in_the_package(tmp_path, write, urdf_at, mesh_at, named):
    path = write(arm(shape=mesh(named.format(package=tmp_path / "package"))), urdf_at)
    if "deep" in urdf_at:
        (tmp_path / "package/package.xml").write_text("<package/>")
    file = tmp_path / mesh_at
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(stl(TETRAHEDRON))
    assert len(load_arm(path).meshes[0].triangles) == 4


def test_any_urdf_may_use_the_meshes_of_the_robots_that_ship(write):
    found = next(robot_data().glob("ur_description/meshes/ur5/collision/*.stl")).relative_to(robot_data().parent)
    assert load_arm(write(arm(shape=mesh(f"package://example-robot-data/{found}")))).meshes


@pytest.mark.parametrize(
    "named",
    [
        "%2e%2e/secret.stl",
        "..\\secret.stl",
        "model://../secret.stl",
        "package://package/%2e%2e/secret.stl",
        "{folder}/package/../secret.stl",
        "LINKED/SECRET.STL",
        "/{folder}/secret.stl",
        "file:///{folder}/secret.stl",
        "//{folder}/secret.stl",
        "../secret.stl",
        "package://../secret.stl",
        "package://package/../secret.stl",
        "package:////{folder}/secret.stl",
        "package://package//{folder}/secret.stl",
        "package://example-robot-data/../../../../../../../../../../../../../{folder}/secret.stl",
        "meshes/../../secret.stl",
        "secret.stl",
        "package://secret.stl",
        "link.stl",
        "linked/secret.stl",
        "http://localhost/secret.stl",
    ],
)
def test_meshes_elsewhere_are_not_opened(tmp_path, write, named, monkeypatch):
    (tmp_path / "secret.stl").write_bytes(stl(TETRAHEDRON))
    path = write(arm(shape=mesh(named.format(folder=tmp_path))))
    (path.parent / "meshes").mkdir()
    (path.parent / "link.stl").symlink_to("../secret.stl")
    (path.parent / "linked").symlink_to("..")
    monkeypatch.setattr(meshes, "_parse", lambda *_: pytest.fail("a mesh was opened"))
    with pytest.raises(ConfigurationError, match=r"link 'upper' .*(outside|absolute|not found)"):
        load_arm(path)


@pytest.mark.parametrize(
    ("named", "says"),
    [
        ("package://gripper/meshes/g.stl", "'package/meshes/g.stl'.*put it below 'package'.*package.xml"),
        ("../meshes/g.stl", "outside of the URDF's package 'package': put it below 'package'"),
        ("", "has no file name"),
        ("meshes", "not found .* as 'package/meshes'"),
        ("link.3mf", r"Blender or MeshLab as one of \.stl"),
    ],
)
def test_where_a_mesh_was_looked_for_is_told_and_what_helps(tmp_path, write, named, says):
    for file in ("gripper/meshes/g.stl", "meshes/g.stl", "package/link.3mf", "package/meshes/x"):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_bytes(stl(TETRAHEDRON))
    with pytest.raises(ConfigurationError, match=says):
        load_arm(write(arm(shape=mesh(named))))


def test_the_package_of_the_folder_above_is_not_its_own(tmp_path, write):
    """Without a `package.xml`, a URDF beside other folders has only its own."""
    (tmp_path / "secret.stl").write_bytes(stl(TETRAHEDRON))
    with pytest.raises(ConfigurationError, match="the folder 'package'"):
        load_arm(write(arm(shape=mesh("package://x/secret.stl"))))


WRONG_MESHES = {
    "flat": ("link.stl", stl(TETRAHEDRON * [1, 1, 0]), "is flat"),
    "flat, askew": ("link.stl", stl(TETRAHEDRON[[0, 1, 2, 2]] @ [[1, 1, 1], [1, 2, 3], [0, 0, 0]]), "is flat"),
    "a point": ("link.stl", stl(TETRAHEDRON * 0), "is flat|cannot be read"),
    "tiny": ("link.stl", stl(TETRAHEDRON * 1e-5), "is tiny|is flat"),
    "not a number": ("link.stl", stl(TETRAHEDRON * np.nan), "not numbers"),
    "infinite": ("link.stl", stl(np.where(TETRAHEDRON > 0, np.inf, 0)), "not numbers"),
    "beyond any": ("link.stl", stl(TETRAHEDRON * 1e30), "not numbers, or beyond"),
    "no triangles": ("link.stl", stl(TETRAHEDRON, ()), "empty|cannot be read"),
    "no bytes": ("link.stl", b"", "cannot be read"),
    "one triangle of a million": ("link.stl", stl(TETRAHEDRON)[:80] + struct.pack("<I", 10**6), "cannot be read"),
    "no mesh's name": ("link.txt", b"text", r"\.stl"),
    "a scene of a scene": (
        "link.dae",
        b'<COLLADA><library_nodes><node id="a"><instance_node url="#a"/></node></library_nodes></COLLADA>',
        "instance_node",
    ),
    "deep": ("link.dae", b"<COLLADA>" + b"<node>" * 100_000, "within each other"),
    "no XML": ("link.dae", b"junk", "cannot be read"),
    "entities": ("link.dae", b'<!DOCTYPE COLLADA [<!ENTITY a "a">]><COLLADA/>', "document type"),
}


@pytest.mark.parametrize(("name", "content", "says"), WRONG_MESHES.values(), ids=WRONG_MESHES)
def test_what_is_wrong_with_a_mesh_is_said(write, name, content, says):
    path = write(arm(shape=mesh(name)))
    (path.parent / name).write_bytes(content)
    with pytest.raises(ConfigurationError, match=f"the mesh '{name}' of a <mesh> of link 'upper' .*({says})"):
        load_arm(path)


def test_large_meshes_are_refused(write, monkeypatch):
    monkeypatch.setattr(meshes, "MAX_BYTES", 3 * len(stl(TETRAHEDRON)) - 1)
    third = f"<collision><geometry>{mesh('link.stl')}</geometry></collision>"
    path = write(arm(shape=mesh("link.stl")).replace("</link><joint", f"{third * 2}</link><joint"))
    (path.parent / "link.stl").write_bytes(stl(TETRAHEDRON))
    with pytest.raises(ConfigurationError, match="'upper' is too large"):
        load_arm(path)


VERTICES = "".join(f"v {x} {y} {z}\n" for x, y, z in TETRAHEDRON)
FACES = "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    "line",
    [
        "mtllib colours.mtl\n",
        "mtllib\tcolours.mtl\r",
        "mtl\\\nlib colours.mtl\n",
        "mtl\\\r\nlib colours.mtl\r\n",
        "m\\\nt\\\nl\\\nlib colours.mtl\n",
        "v 1 1 1\fmtl\\\nlib colours.mtl\n",
        "v 1 1 1\0mtl\\\nlib colours.mtl\n",
        "v 1 1 1 \\ 2\nmtl\\\nlib colours.mtl\n",
        "# \\\nmtl\\\nlib colours.mtl\n",
    ],
)
def test_a_material_library_is_not_opened(write, line):
    path = write(arm(shape=mesh("link.obj")))
    os.mkfifo(path.parent / "colours.mtl")  # who opens it waits for ever
    (path.parent / "link.obj").write_bytes(f"{VERTICES}{line}{FACES}".encode())
    done = subprocess.run(
        [sys.executable, "-c", f"import armctl; print(len(armctl.load_arm({str(path)!r}).meshes[0].triangles))"],
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.stdout == "4\n" or "of link 'upper' cannot be read" in done.stderr


@pytest.mark.parametrize(
    "faces",
    [
        FACES.replace("\n", "\r\n"),
        FACES.replace("f ", "f\t ").replace("\n", " # a face\n"),
        FACES.replace("f 1 3 2\n", "f 1 3 \\\n2\n"),
        "vt 0 0\nvn 0 0 1\no a\ng b\nusemtl c\ns 1\n" + re.sub(r"(\d)", r"\1/1/1", FACES),
        "vn 0 0 1\n" + re.sub(r"(\d)", r"\1//1", FACES),
        re.sub(r"(\d)", lambda found: str(int(found[1]) - 5), FACES),
    ],
)
def test_an_obj_file_is_read_as_others_write_it(write, faces):
    path = write(arm(shape=mesh("link.obj")))
    (path.parent / "link.obj").write_bytes((VERTICES + faces).encode())
    found = load_arm(path).meshes[0]
    assert len(found.triangles) == 4
    np.testing.assert_allclose(np.sort(found.vertices, axis=0), np.sort(TETRAHEDRON, axis=0), atol=1e-6)


@pytest.mark.parametrize("name", ["laikago_description/meshes/calf.obj", "alexander_description/meshes/Foot.obj"])
def test_obj_files_that_ship_keep_their_triangles(name):
    path = robot_data() / name
    expected = coal.MeshLoader().load(str(path), np.ones(3))
    vertices, triangles = meshes.Meshes(path, robot_data()).read(path.name, np.ones(3))
    corners = np.array([[expected.tri_indices(i)[k] for k in range(3)] for i in range(expected.num_tris)])
    np.testing.assert_allclose(vertices[triangles], np.asarray(expected.vertices())[corners])


def test_a_robot_that_ships_may_be_copied(tmp_path):
    shutil.copytree(robot_data() / "ur_description/urdf", tmp_path / "urdf")
    assert load_arm(tmp_path / "urdf/ur5_robot.urdf", tip="ee_link").dof == 6


def dae(matrix="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1", unit='<unit name="meter" meter="1"/>'):
    """A tetrahedron as COLLADA, in a node with a matrix."""
    numbers = " ".join(map(str, TETRAHEDRON.ravel()))
    accessor = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
    return f"""<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>{unit}</asset>
    <library_geometries><geometry id="g"><mesh><source id="p"><float_array id="a" count="12">{numbers}</float_array>
    <technique_common><accessor source="#a" count="4" stride="3">{accessor}</accessor></technique_common></source>
    <vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="4">
    <input semantic="VERTEX" source="#v" offset="0"/><p>0 2 1 0 1 3 0 3 2 1 2 3</p></triangles></mesh></geometry>
    </library_geometries><library_visual_scenes><visual_scene id="s"><node><matrix>{matrix}</matrix>
    <instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
    <scene><instance_visual_scene url="#s"/></scene></COLLADA>""".encode()


OUTWARD = stl(TETRAHEDRON)
INWARD = stl(TETRAHEDRON, ((0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)))


@pytest.mark.parametrize("scale", ["1 1 1", "1 -1 1", "-1 -1 1", "-1 -1 -1", "-0.5 2 1"])
@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("link.stl", OUTWARD),
        ("link.stl", INWARD),
        ("link.obj", (VERTICES + FACES).encode()),
        ("link.dae", dae()),
        ("link.dae", dae("-1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1")),
    ],
    ids=["stl", "inside out", "obj", "dae", "mirrored dae"],
)
def test_a_mesh_is_never_inside_out(write, name, content, scale):
    path = write(arm(shape=f'<mesh filename="{name}" scale="{scale}"/>'))
    (path.parent / name).write_bytes(content)
    (found,) = load_arm(path).meshes
    volume = np.linalg.det(found.vertices[found.triangles]).sum() / 6
    np.testing.assert_allclose(volume, 0.2**3 / 6, rtol=1e-5)


@pytest.mark.parametrize("metres", [0.001, 0.0254])
def test_the_unit_of_a_file_counts(write, metres):
    path = write(arm(shape='<mesh filename="link.dae" scale="100 100 100"/>'))
    (path.parent / "link.dae").write_bytes(dae(unit=f'<unit meter="{metres}"/>'))
    np.testing.assert_allclose(load_arm(path).meshes[0].vertices.max(axis=0), 20 * metres, rtol=1e-5)


@pytest.mark.parametrize("metres", ["0", "-1", "nan", "inf", "1e300", "much"])
def test_a_unit_that_is_no_length_is_refused(write, metres):
    path = write(arm(shape=mesh("link.dae")))
    (path.parent / "link.dae").write_bytes(dae(unit=f'<unit meter="{metres}"/>'))
    with pytest.raises(ConfigurationError, match=f"has a unit of '{metres}' m"):
        load_arm(path)

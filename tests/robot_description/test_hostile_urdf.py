"""A URDF is data from a stranger: what is malformed, too large or reaches out of its package is refused in words."""

import itertools
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
from armctl.robot_description import load_arm, meshes, urdf, xml_file
from armctl.robot_description.arm import robot_data

INERTIA = '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>'
TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 0.2
LIMIT = '<limit lower="-1" upper="1" velocity="1" effort="9"/>'


def arm(
    inertia=INERTIA,
    placed="",
    origin='<origin xyz="0 0 1"/>',
    shape='<sphere radius=".1"/>',
    axis="",
    mass="1",
    more="",
):
    return (
        f'<robot name="small"><link name="base"/><link name="upper"><inertial>{placed}<mass value="{mass}"/>{inertia}'
        f"</inertial><collision><geometry>{shape}</geometry></collision></link>"
        f'<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>{origin}{axis}{LIMIT}'
        f"</joint>{more}</robot>"
    )


def fixed(parent, name):
    ends = f'<parent link="{parent}"/><child link="{name}"/>'
    return f'<link name="{name}"/><joint name="{name}" type="fixed">{ends}</joint>'


def chain(links):
    """An arm, and behind it that many fixed links."""
    names = ["upper", *(f"l{i}" for i in range(links))]
    return arm(more="".join(fixed(parent, name) for parent, name in itertools.pairwise(names)))


def stl(corners, faces=((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))):
    triangles = [struct.pack("<12fH", 0, 0, 0, *np.ravel([corners[i] for i in face]), 0) for face in faces]
    return b" " * 80 + struct.pack("<I", len(triangles)) + b"".join(triangles)


def mesh(name):
    return f'<mesh filename="{name}"/>'


@pytest.fixture
def write(tmp_path):
    """Writes a URDF to a package in a folder of its own."""

    def write(text, name="package/arm.urdf"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        return path

    return write


def test_the_small_arm_is_fine(write):
    origin = '<origin xyz="0 0 1" rpy="0 0 0"/>'
    assert load_arm(write(arm(origin=origin, placed=origin, axis='<axis xyz="0 0 2"/>'))).dof == 1


MALFORMED = {
    "no ixy": ({"inertia": INERTIA.replace('ixy="0" ', "")}, "'upper'.* no ixy"),
    "no inertia": ({"inertia": ""}, "'upper'.* no ixx and no ixy"),
    "inertia in words": ({"inertia": INERTIA.replace('"0.01"', '"much"', 1)}, "'upper'.*'much'"),
    "mass in words": ({"mass": "much"}, "mass of link 'upper'.*'much'"),
    "mass below zero": ({"mass": "-1"}, "'upper' has a mass of -1"),
    "mass infinite": ({"mass": "1e999"}, "'upper'.*'1e999'"),
    "mass that is no mass": ({"mass": "1e-30"}, "'upper'.* no mass"),
    "inertia placed in letters": ({"placed": '<origin xyz="a b c"/>'}, "inertia of link 'upper'.*'a'"),
    "origin in letters": ({"origin": '<origin xyz="a b c"/>'}, "origin of joint 'shoulder'.*'a'"),
    "origin of two numbers": ({"origin": '<origin xyz="1 2"/>'}, "origin of joint 'shoulder'.*3 numbers.*'1 2'"),
    "origin not a number": ({"origin": '<origin xyz="0 0 nan"/>'}, "origin of joint 'shoulder'.*'nan'"),
    "origin infinite": ({"origin": '<origin rpy="0 -inf 0"/>'}, "origin of joint 'shoulder'.*'-inf'"),
    "origin beyond any": ({"origin": '<origin xyz="0 0 1e300"/>'}, "origin of joint 'shoulder'.*'1e300'"),
    "axis of no length": ({"axis": '<axis xyz="0 0 1e-200"/>'}, "'shoulder' has an axis of length"),
    "very long number": ({"mass": "x" * 100_000}, r"mass of link 'upper': 'xxx.{,60} is not"),
    "ring beside a root": (
        {
            "more": '<link name="x"/><link name="y"/>'
            '<joint name="a" type="fixed"><parent link="x"/><child link="y"/></joint>'
            '<joint name="b" type="fixed"><parent link="y"/><child link="x"/></joint>'
        },
        "tree",
    ),
    "sphere without size": ({"shape": '<sphere radius="1e-300"/>'}, "'upper' has a size of 1e-300"),
    "a world on a joint": ({"more": fixed("upper", "world")}, "'world'"),
    "the floor": ({"more": fixed("upper", "(floor)")}, "'.floor.'"),
    "deep": ({"more": "<a>" * 100_000 + "</a>" * 100_000}, "elements within each other"),
    "many shapes": (
        {"shape": '<sphere radius="1"/></geometry></collision>' + "<collision/>" * 1_000 + "<collision><geometry>"},
        "1002 collision shapes; at most 1000",
    ),
}


@pytest.mark.parametrize(("parts", "culprit"), MALFORMED.values(), ids=MALFORMED)
def test_a_malformed_part_is_named(write, parts, culprit):
    with pytest.raises(ConfigurationError, match=culprit):
        load_arm(write(arm(**parts)))


def test_as_many_links_as_a_file_may_have_are_read_and_more_are_refused(write):
    assert load_arm(write(chain(urdf.MAX_LINKS - 2))).dof == 1
    with pytest.raises(ConfigurationError, match="302 links; at most 300"):
        load_arm(write(chain(urdf.MAX_LINKS)))


@pytest.mark.slow
def test_a_long_chain_ends_in_words_not_in_a_crash(write):
    path = write(chain(5_000))
    done = subprocess.run(
        [sys.executable, "-c", f"import armctl; armctl.load_arm({str(path)!r})"], capture_output=True, text=True
    )
    assert done.returncode == 1, done.returncode
    assert "ConfigurationError: arm.urdf is not an arm that armctl can use: it has 5002 links" in done.stderr


def test_a_large_file_is_refused(write):
    with pytest.raises(ConfigurationError, match="bytes, more than"):
        load_arm(write(arm(more=f"<!--{'x' * xml_file.MAX_BYTES}-->")))


@pytest.mark.parametrize(
    "doctype",
    [
        '<!DOCTYPE robot [<!ENTITY secret SYSTEM "file:///etc/hostname">]>',
        '<!DOCTYPE robot SYSTEM "http://127.0.0.1/robot.dtd">',
        '<!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>',
    ],
)
def test_entities_are_refused(write, doctype):
    with pytest.raises(ConfigurationError, match="document type"):
        load_arm(write(doctype + arm()))


@pytest.mark.parametrize("name", ["\0.urdf", "a" * 300 + ".urdf", "loop/arm.urdf", "."])
def test_a_name_that_is_no_file_is_refused(tmp_path, name, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loop").symlink_to("loop")
    for options in ({"robot": name}, {"robot": "ur5", "srdf": name}):
        with pytest.raises(ConfigurationError, match="there is no robot"):
            load_arm(**options)


# Meshes


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
    ],
)
def test_meshes_are_found_in_the_package(tmp_path, write, urdf_at, mesh_at, named):
    path = write(arm(shape=mesh(named)), urdf_at)
    if "deep" in urdf_at:
        (tmp_path / "package/package.xml").write_text("<package/>")
    file = tmp_path / mesh_at
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(stl(TETRAHEDRON))
    assert len(load_arm(path).meshes[0].triangles) == 4


def test_any_urdf_may_use_the_meshes_of_the_robots_that_ship(write):
    found = next(robot_data().glob("ur_description/meshes/ur5/collision/*.stl")).relative_to(robot_data().parent)
    assert load_arm(write(arm(shape=mesh(f"package://example-robot-data/{found}")))).meshes


@pytest.mark.parametrize(
    "named",
    [
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


def test_a_pipe_as_a_robot_does_not_hang(tmp_path):
    os.mkfifo(tmp_path / "arm.urdf")
    with pytest.raises(ConfigurationError, match="not a regular file"):
        xml_file.read_xml(tmp_path / "arm.urdf")

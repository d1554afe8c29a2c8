"""Binary glTF files are read as they are written: scenes, nodes, strips and fans; what is malformed is refused."""

import json

import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.robot_description import gltf, load_arm
from armctl.robot_description.gltf import read_glb

from .one_joint_arm import TETRAHEDRON, arm, mesh
from .test_collada import CUBE, TRIANGLES

QUAD = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]


def glb(corners=CUBE, indices=TRIANGLES, mode=None, nodes=({"mesh": 0},), stride=12, kind=np.uint16, **parts):
    """A shape in these nodes, the first of which is the scene's; `parts` replace those of the description."""
    points = np.zeros((len(corners), stride // 4), "<f4")
    points[:, :3] = corners
    flat = np.ravel(indices).astype(kind)
    code = {np.uint8: 5121, np.uint16: 5123, np.uint32: 5125, np.float32: 5126}[kind]
    primitive = {"attributes": {"POSITION": 0}, "indices": 1} | ({} if mode is None else {"mode": mode})
    root = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": list(nodes),
        "meshes": [{"primitives": [primitive]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": len(corners)},
            {"bufferView": 1, "componentType": code, "type": "SCALAR", "count": len(flat)},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": points.nbytes, "byteStride": stride},
            {"buffer": 0, "byteOffset": points.nbytes, "byteLength": flat.nbytes},
        ],
        "buffers": [{"byteLength": points.nbytes + flat.nbytes}],
    } | parts
    chunks = ((b"JSON", json.dumps(root).encode()), (b"BIN\0", points.tobytes() + flat.tobytes()))
    body = b"".join(len(content).to_bytes(4, "little") + kind + content for kind, content in chunks)
    return b"glTF\x02\0\0\0" + (12 + len(body)).to_bytes(4, "little") + body


def volume(mesh):
    vertices, corners = mesh
    return np.linalg.det(vertices[corners] - vertices.mean(axis=0)).sum() / 6


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.uint32])
@pytest.mark.parametrize("stride", [12, 24])
def test_a_cube_has_its_volume(kind, stride):
    vertices, corners = read_glb(glb(kind=kind, stride=stride))
    assert corners.shape == (12, 3)
    np.testing.assert_array_equal(vertices, CUBE)
    assert abs(volume((vertices, corners))) == pytest.approx(1)


def test_nodes_are_placed_within_each_other_and_a_mesh_may_have_two():
    turned = {"rotation": [0, 0, np.sqrt(0.5), np.sqrt(0.5)], "translation": [0, 0, 5], "scale": [2, 1, 1]}
    shifted = {"matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 0, 0, 1]}
    nodes = ({"children": [1, 2], **turned}, {"mesh": 0, **shifted}, {"mesh": 0}, {"mesh": 0})
    vertices, corners = read_glb(glb(nodes=nodes))
    assert len(corners) == 24
    # z by a quarter turn: x becomes y, y becomes -x; the fourth node is in no scene
    np.testing.assert_allclose(vertices[:8].max(axis=0), [0, 8, 6], atol=1e-9)
    np.testing.assert_allclose(vertices[:8].min(axis=0), [-1, 6, 5], atol=1e-9)
    np.testing.assert_allclose(vertices[8:].max(axis=0), [0, 2, 6], atol=1e-9)


def test_without_a_scene_all_roots_are_read():
    content = glb(nodes=({"mesh": 0}, {"children": [2]}, {"mesh": 0}), scenes=[{"nodes": [0, 1]}])
    assert len(read_glb(content)[1]) == 24
    assert len(read_glb(content.replace(b'"scenes"', b'"absent"'))[1]) == 24


@pytest.mark.parametrize(
    ("mode", "indices", "expected"),
    [
        (gltf.STRIP, [0, 1, 2, 3], [[0, 1, 2], [2, 1, 3]]),
        (gltf.FAN, [0, 1, 3, 2], [[0, 1, 3], [0, 3, 2]]),
        (gltf.TRIANGLES, [0, 1, 2, 3], [[0, 1, 2]]),
        (gltf.STRIP, [0, 1], np.empty((0, 3))),
        (1, [0, 1], np.empty((0, 3))),
    ],
)
def test_strips_and_fans_keep_the_sides_of_their_triangles(mode, indices, expected):
    np.testing.assert_array_equal(read_glb(glb(QUAD, indices, mode))[1], expected)


MALFORMED = {
    "not binary": (b"{}", "no binary glTF"),
    "nothing inside": (glb()[:12], "cannot be read"),
    "cut off": (glb()[:-10], "cut off"),
    "deep": (b"glTF\x02\0\0\0\0\0\0\0" + (100_000).to_bytes(4, "little") + b"JSON" + b"[" * 100_000, "too deep"),
    "another file": (glb(buffers=[{"uri": "../secret.bin", "byteLength": 999}]), "another file"),
    "compressed": (glb(extensionsRequired=["KHR_draco_mesh_compression"]), "'KHR_draco_mesh_compression'"),
    "a ring of nodes": (glb(nodes=({"mesh": 0, "children": [0]},)), "not a tree"),
    "no such node": (glb(scenes=[{"nodes": [7]}]), "not as glTF has it"),
    "no such vertex": (glb(indices=[0, 1, 8]), "vertices that are missing"),
    "indices of floats": (glb(kind=np.float32), "not a whole number"),
    "not numbers": (glb(corners=np.where(CUBE > 0, np.inf, 0)), "not numbers"),
    "a rotation of nothing": (glb(nodes=({"mesh": 0, "rotation": [0, 0, 0, 0]},)), "cannot be read"),
    "a matrix of words": (glb(nodes=({"mesh": 0, "matrix": ["a"] * 16},)), "cannot be read"),
    "a list": (glb(nodes=[[]]), "not as glTF has it"),
    "nothing to collide": (glb(nodes=({},)), "empty"),
}


@pytest.mark.parametrize(("content", "says"), MALFORMED.values(), ids=MALFORMED)
def test_a_malformed_file_is_refused_in_words(write, content, says):
    path = write(arm(shape=mesh("link.glb")))
    (path.parent / "link.glb").write_bytes(content)
    with pytest.raises(ConfigurationError, match=f"the mesh 'link.glb' of a <mesh> of link 'upper' .*{says}"):
        load_arm(path)


def test_many_instances_of_a_mesh_do_not_fill_the_memory(monkeypatch):
    monkeypatch.setattr(gltf, "MAX_CORNERS", 8 + 36)
    read_glb(glb())
    with pytest.raises(ValueError, match="more than 44"):
        read_glb(glb(nodes=({"mesh": 0, "children": [1]}, {"mesh": 0})))


def test_an_arm_has_the_mesh_in_its_own_axes(write):
    path = write(arm(shape='<mesh filename="link.GLB" scale="1 2 1"/>'))
    (path.parent / "link.GLB").write_bytes(glb(TETRAHEDRON, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    np.testing.assert_allclose(load_arm(path).meshes[0].vertices, TETRAHEDRON * [1, 2, 1], atol=1e-7)

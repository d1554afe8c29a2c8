"""COLLADA files are read as they are written: several groups of polygons, nested nodes, all transformations."""

import coal
import numpy as np
import pytest

from armctl.robot_description.arm import robot_data
from armctl.robot_description.collada import read_collada

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = [(a, b, c) for a, b, c, _ in QUADS] + [(a, c, d) for a, _, c, d in QUADS]
VERTEX = '<input semantic="VERTEX" source="#v" offset="{}"/>'


def words(numbers):
    return " ".join(map(str, np.ravel(numbers).tolist()))


def collada(groups, nodes='<node><instance_geometry url="#g"/></node>', stride=3):
    """A cube of these groups of polygons, in these nodes."""
    positions = np.c_[CUBE, np.full((8, stride - 3), 7)]
    return f"""<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema"><library_geometries><geometry id="g"><mesh>
    <source id="p"><float_array id="a" count="24">{words(positions)}</float_array><technique_common>
    <accessor source="#a" count="8" stride="{stride}"/></technique_common></source>
    <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>{groups}</mesh></geometry></library_geometries>
    <library_visual_scenes><visual_scene id="s">{nodes}</visual_scene></library_visual_scenes></COLLADA>""".encode()


def triangles(faces, offset=0):
    indices = np.zeros((3 * len(faces), 1 + offset), dtype=int)
    indices[:, offset] = np.ravel(faces)
    normal = '<input semantic="NORMAL" source="#n" offset="0"/>' if offset else ""
    return f'<triangles count="{len(faces)}">{normal}{VERTEX.format(offset)}<p>{words(indices)}</p></triangles>'


def polylist(faces):
    sizes = words([len(face) for face in faces])
    corners = words(np.concatenate(faces))
    return f'<polylist count="{len(faces)}">{VERTEX.format(0)}<vcount>{sizes}</vcount><p>{corners}</p></polylist>'


def polygons(faces):
    return f"<polygons>{VERTEX.format(0)}{''.join(f'<p>{words(face)}</p>' for face in faces)}</polygons>"


GROUPS = {
    "triangles": triangles(TRIANGLES),
    "with normals": triangles(TRIANGLES, offset=1),
    "two materials": triangles(TRIANGLES[:5]) + triangles(TRIANGLES[5:]),
    "two layouts": triangles(TRIANGLES[:5]) + triangles(TRIANGLES[5:], offset=2),
    "quads": polylist(QUADS),
    "mixed": polylist([*QUADS[:3], *TRIANGLES[3:6], *TRIANGLES[9:]]),
    "polygons": polygons(QUADS),
    "lines beside": f'<lines count="1">{VERTEX.format(0)}<p>0 7</p></lines>' + polylist(QUADS),
}


def volume(mesh):
    vertices, corners = mesh
    return np.linalg.det(vertices[corners]).sum() / 6


@pytest.mark.parametrize("stride", [3, 4])
@pytest.mark.parametrize("groups", GROUPS.values(), ids=GROUPS)
def test_all_groups_of_polygons_are_read(groups, stride):
    vertices, corners = read_collada(collada(groups, stride=stride))
    assert volume((vertices, corners)) == pytest.approx(1)
    assert len(corners) == 12
    np.testing.assert_array_equal(np.unique(vertices, axis=0), CUBE)


def test_nodes_are_placed_within_each_other_and_may_share_a_geometry():
    inner = "<node><scale>2 2 2</scale><instance_geometry url='#g'/></node>"
    nodes = f"""<node><translate>10 0 0</translate><rotate>0 0 2 90</rotate><instance_geometry url="#g"/>
    <node><matrix>1 0 0 0 0 1 0 0 0 0 1 5 0 0 0 1</matrix>{inner}</node></node>"""
    vertices, corners = read_collada(collada(GROUPS["triangles"], nodes))
    first, second = vertices[:8], vertices[8:]
    turned = CUBE @ [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    np.testing.assert_allclose(first, turned + np.array([10, 0, 0]), atol=1e-12)
    np.testing.assert_allclose(second, 2 * turned + np.array([10, 0, 5]), atol=1e-12)
    assert volume((vertices, corners)) == pytest.approx(1 + 8)


ONE = GROUPS["triangles"]
MALFORMED = {
    "vertex beyond": collada(triangles([(0, 1, 8)])),
    "vertex below": collada(triangles([(0, 1, -1)])),
    "endless polygon": collada(GROUPS["quads"].replace("<vcount>4", "<vcount>999999999999")),
    "polygon below": collada(GROUPS["quads"].replace("<vcount>4", "<vcount>-4")),
    "far offset": collada(ONE.replace('offset="0"', 'offset="999999999999"')),
    "no vertices": collada(ONE.replace("VERTEX", "NORMAL")),
    "no stride": collada(ONE).replace(b'stride="3"', b'stride="0"'),
    "stride below": collada(ONE).replace(b'stride="3"', b'stride="-3"'),
    "wide stride": collada(ONE).replace(b'stride="3"', b'stride="99999999999"'),
    "no such geometry": collada(ONE, '<node><instance_geometry url="#h"/></node>'),
    "short matrix": collada(ONE, '<node><matrix>1 0</matrix><instance_geometry url="#g"/></node>'),
    "skew": collada(ONE, '<node><skew>1</skew><instance_geometry url="#g"/></node>'),
    "words": collada(ONE.replace("7", "x")),
}


@pytest.mark.parametrize("content", MALFORMED.values(), ids=MALFORMED)
def test_what_is_malformed_is_refused(content):
    with pytest.raises((ArithmeticError, LookupError, ValueError)):
        read_collada(content)


def test_a_file_that_ships_is_read_as_another_library_reads_it():
    path = robot_data() / "panda_description/meshes/visual/link1.dae"
    expected = coal.MeshLoader().load(str(path), np.ones(3))
    corners = np.array([[expected.tri_indices(i)[k] for k in range(3)] for i in range(expected.num_tris)])
    points = np.array(expected.vertices())
    vertices, found = read_collada(path.read_bytes())
    assert volume((vertices, found)) == pytest.approx(volume((points, corners)), rel=1e-4)
    np.testing.assert_allclose(vertices.min(axis=0), points.min(axis=0), atol=1e-6)
    np.testing.assert_allclose(vertices.max(axis=0), points.max(axis=0), atol=1e-6)

"""An own arm is drawn as its file has it, and collides as capsules."""

import re

import mujoco
import numpy as np
import pytest

from armctl.robot_description import load_arm
from armctl.robots import build_arm_world

from .one_joint_arm import TETRAHEDRON, arm, mesh, stl

BOX, CYLINDER, SPHERE = '<box size=".2 .3 .4"/>', '<cylinder radius=".1" length=".4"/>', '<sphere radius=".1"/>'
VOLUMES = {BOX: 0.024, CYLINDER: 0.004 * np.pi, SPHERE: 0.004 / 3 * np.pi}
COLLAPSED = "".join(f"v {x} 0 0\n" for x in range(3)) + "f 1 2 3\n"


def visual(shape, origin=""):
    return f"</collision><visual>{origin}<geometry>{shape}</geometry></visual>"


def drawn(path):
    """The drawn shapes of the moving link, and whether its capsule is seen."""
    description = load_arm(path)
    world = build_arm_world(description, "position")
    capsule = world.geom("upper_collision")
    return [shape for shape in description.meshes if shape.link == "upper"], int(capsule.group[0]) == 2


def volume(shape):
    return np.linalg.det(shape.vertices[shape.triangles]).sum() / 6


@pytest.mark.parametrize("shape", VOLUMES)
@pytest.mark.parametrize("kind", ["collision", "visual"])
def test_primitives_are_drawn_as_they_are_and_face_outward(write, shape, kind):
    text = arm(shape=shape) if kind == "collision" else arm().replace("</collision>", visual(shape))
    (found,), capsule = drawn(write(text))
    corners, centre = found.vertices[found.triangles], found.vertices.mean(axis=0)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert ((normals * (corners[:, 0] - centre)).sum(axis=1) > 0).all()
    assert volume(found) == pytest.approx(VOLUMES[shape], rel=0.03)
    assert not capsule


def test_a_visual_shape_is_drawn_and_the_collision_shape_collides(write):
    placed = '<origin xyz="0 0 0.5"/>'
    path = write(arm(shape=SPHERE).replace("</collision>", visual(BOX, placed) + visual(mesh("link.stl"))[12:]))
    (path.parent / "link.stl").write_bytes(stl(TETRAHEDRON))
    found, capsule = drawn(path)
    assert [len(shape.triangles) for shape in found] == [12, 4]
    np.testing.assert_allclose(found[0].vertices.max(axis=0), [0.1, 0.15, 0.7])
    assert not capsule
    (collides,) = (capsule for capsule in load_arm(path).capsules if capsule.link == "upper")
    assert collides.radius < 0.12


UNREADABLE = {
    "missing": (mesh("none.stl"), "not found"),
    "format": (mesh("link.3mf"), "no mesh of a format"),
    "flat": (mesh("flat.obj"), "flat|cannot be read"),
    "unknown": ('<cone radius="1"/>', "cone"),
    "nothing": ("", "<visual> without a shape"),
}


@pytest.mark.parametrize(("shape", "reason"), UNREADABLE.values(), ids=UNREADABLE)
def test_an_unreadable_visual_is_told_and_the_collision_shape_is_drawn(write, shape, reason):
    path = write(arm(shape=BOX).replace("</collision>", visual(shape)))
    (path.parent / "link.3mf").write_bytes(b"glTF")
    (path.parent / "flat.obj").write_text(COLLAPSED)
    (found,), _ = drawn(path)
    assert volume(found) == pytest.approx(VOLUMES[BOX])
    assert re.search(f"Link 'upper' is drawn as it collides, since .*({reason})", "".join(load_arm(path).notes))


RED = '<material name="red"><color rgba="0.9 0.1 0 1"/></material>'


@pytest.mark.parametrize(
    ("own", "robots", "expected"),
    [
        (RED, "", (0.9, 0.1, 0, 1)),
        ('<material name="red"/>', RED, (0.9, 0.1, 0, 1)),
        ('<material name="blue"/>', RED, None),
        (RED.replace("0.9", "9"), "", None),
        (RED.replace("0.9", "nan"), "", None),
        (RED.replace("0.9", "much"), "", None),
        (RED.replace(" 1", ""), "", None),
        ("", RED, None),
    ],
)
def test_a_visual_shape_has_its_colour(write, own, robots, expected):
    coloured = visual(BOX).replace("</visual>", f"{own}</visual>")
    path = write(arm().replace("</collision>", coloured).replace("</robot>", f"{robots}</robot>"))
    (found,), _ = drawn(path)
    assert found.colour == expected
    world = build_arm_world(load_arm(path), "position")
    (geom,) = (world.geom(i) for i in range(world.ngeom) if world.geom(i).type == mujoco.mjtGeom.mjGEOM_MESH)
    if expected is None:
        assert geom.matid >= 0
    else:
        np.testing.assert_allclose(geom.rgba, expected)
        assert geom.matid == -1


def test_a_link_without_a_collision_shape_is_drawn_too(write):
    path = write(arm().replace('<link name="base"/>', f'<link name="base">{visual(BOX)[12:]}</link>'))
    assert [shape.link for shape in load_arm(path).meshes] == ["base", "upper"]
    assert [capsule.link for capsule in load_arm(path).capsules] == ["upper"]


def test_a_shape_too_thin_for_a_mesh_is_drawn_as_its_capsule(write):
    found, capsule = drawn(write(arm(shape='<box size="0.2 0.2 1e-8"/>')))
    assert not found
    assert capsule


def test_what_is_drawn_changes_no_physics(write):
    worlds = [
        build_arm_world(load_arm(write(text)), "position")
        for text in (arm(shape=BOX), arm(shape=BOX).replace("</collision>", visual(SPHERE)))
    ]
    for field in ("body_mass", "body_inertia", "body_ipos", "pair_geom1", "actuator_gainprm"):
        np.testing.assert_array_equal(*(getattr(world, field) for world in worlds))
    assert all(isinstance(world, mujoco.MjModel) for world in worlds)

import contextlib
import itertools
import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np
import pinocchio
import pytest
from scipy.spatial.transform import Rotation

from armctl.core.errors import ConfigurationError
from armctl.kernels.edges import LINKS
from armctl.kinematics import ArmModel
from armctl.kinematics.clearance import Clearance
from armctl.robot_description import BUILTIN_ARMS, load_arm
from armctl.robot_description import arm as arms
from armctl.robot_description.builtin import MAX_ACCELERATION
from armctl.robot_description.collision_pairs import FLOOR
from armctl.simulation.worlds import world_path

from .small_arm import BOX, CYLINDER, FINGER, SPHERE, continuous, everywhere, joint, limited, link

WORLD_ROOT = {"world": '<link name="world"/>', "fixed": joint("fixed", "world", "base", "fixed")}


def tip_position(q):
    """Where the good arm's tip is: it turns about z, then y; the last joint moves nothing."""
    return np.array([0, 0, 0.8]) + Rotation.from_euler("ZY", q[:2]).apply([0, 0, 0.4])


def outermost(capsule, points):
    """Largest distance (m) of the points from the capsule's segment."""
    start, axis = np.array(capsule.start), np.subtract(capsule.end, capsule.start)
    along = np.clip((points - start) @ axis / max(axis @ axis, 1e-300), 0, 1)
    return np.linalg.norm(points - start - along[:, None] * axis, axis=1).max()


def example_data(path):
    return arms.robot_data() / path


# Built-in arms


@pytest.mark.one_case
@pytest.mark.parametrize("robot", BUILTIN_ARMS)
def test_limits_are_the_numbers_of_the_urdf(robot):
    arm = load_arm(robot)
    file = ElementTree.parse(example_data(BUILTIN_ARMS[robot].urdf))
    limits = [file.find(f"joint[@name='{name}']/limit") for name in arm.joints]
    assert len(limits) == arm.dof
    for name in ("lower", "upper", "velocity", "effort"):
        np.testing.assert_array_equal(getattr(arm.limits, name), [float(limit.get(name)) for limit in limits])


@pytest.mark.one_case
@pytest.mark.parametrize("robot", BUILTIN_ARMS)
def test_mesh_vertices_lie_within_their_links_capsule(robot):
    arm = load_arm(robot)
    capsules = {capsule.link: capsule for capsule in arm.capsules}
    assert arm.meshes
    for mesh in arm.meshes:
        capsule = capsules[mesh.link]
        assert outermost(capsule, mesh.vertices) <= capsule.radius + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("robot", BUILTIN_ARMS)
def test_home_is_free_and_neighbours_are_not_tested(robot):
    model = ArmModel(robot)
    assert model.is_free(model.home)
    neighbours = set(itertools.pairwise(capsule.link for capsule in model.description.capsules))
    assert not neighbours & set(model.description.collision_pairs)


@pytest.mark.parametrize(
    ("wrong", "nearest"),
    [("ur6", "ur5"), ("ur55", "ur5"), ("ur_10", "ur10"), ("ur3e", "ur3"), ("pandas", "panda"), ("kuka", "")],
)
def test_unknown_robot_is_told_the_names_there_are(wrong, nearest):
    with pytest.raises(ConfigurationError, match=f"'{wrong}'.*There are: .*ur10, ur3, ur5") as error:
        load_arm(wrong)
    assert ("Did you mean" in str(error.value)) == bool(nearest)
    assert nearest in str(error.value)


def test_missing_file_is_named():
    with pytest.raises(ConfigurationError, match=r"nowhere/arm\.urdf"):
        load_arm("nowhere/arm.urdf")


def test_a_description_is_taken_as_it_is():
    arm = load_arm("ur5")
    assert load_arm(arm) is arm


def test_options_beside_a_description_are_not_dropped_in_silence():
    with contextlib.suppress(ConfigurationError):
        np.testing.assert_array_equal(load_arm(load_arm("ur5"), home=np.zeros(6)).home, np.zeros(6))


def test_a_caller_cannot_spoil_the_next_arm():
    first = load_arm("ur5").home
    expected = first.copy()
    with contextlib.suppress(ValueError):
        first += 0.1
    found = load_arm("ur5").home.copy()
    with contextlib.suppress(ValueError):
        first[:] = expected
    np.testing.assert_array_equal(found, expected)


def test_world_is_found():
    assert mujoco.MjSpec.from_file(str(world_path("arm_reach"))).geom("floor")


# Arms of one's own


def test_forward_kinematics_of_a_small_arm(urdf):
    _, model, world = everywhere(urdf())
    data = mujoco.MjData(world)
    for q in np.random.default_rng(0).uniform(-2, 2, (100, 3)):
        data.qpos[:] = q
        mujoco.mj_kinematics(world, data)
        np.testing.assert_allclose(model.position(q), tip_position(q), atol=1e-12)
        np.testing.assert_allclose(data.body("arm/l3").xpos, tip_position(q), atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "dof"), [("z1", 6), ("panda", 7), ("xarm7", 7)])
def test_arms_that_are_no_ur(robot, dof):
    description, model, world = everywhere(robot)
    assert description.dof == model.dof == world.nv == dof
    assert model.is_free(description.home)
    assert model.within_limits(description.home)


def test_acceleration_limits_may_differ_from_joint_to_joint():
    np.testing.assert_array_equal(load_arm("panda").limits.acceleration, [15, 7.5, 10, 12.5, 15, 20, 20])
    np.testing.assert_array_equal(load_arm("panda", max_acceleration=3).limits.acceleration, np.full(7, 3.0))
    limits = load_arm("ur5", max_acceleration=np.arange(1.0, 7.0), max_jerk=[9] * 6).limits
    np.testing.assert_array_equal(limits.acceleration, np.arange(1, 7))
    np.testing.assert_array_equal(limits.jerk, np.full(6, 9.0))


@pytest.mark.parametrize("name", ["j1", "j3", "floor", "target"])
def test_links_may_have_any_name(urdf, name):
    parts = {"l1": link(name, BOX), "j1": joint("j1", "base", name, axis="0 0 1"), "j2": joint("j2", name, "l2")}
    _, model, world = everywhere(urdf(**parts))
    np.testing.assert_allclose(model.position(np.ones(3)), tip_position(np.ones(3)))
    assert world.nv == 3


@pytest.mark.parametrize(
    "limit",
    [
        '<limit velocity="3" effort="5"/>',
        '<limit lower="0" upper="0" velocity="3" effort="5"/>',
        '<limit lower="-1" upper="1" velocity="3" effort="5"/>',
    ],
)
def test_continuous_joint_turns_either_way_whatever_its_bounds_say(urdf, limit):
    description, model, world = everywhere(urdf(**continuous(limit)))
    np.testing.assert_allclose([description.limits.lower[0], description.limits.upper[0]], [-2 * np.pi, 2 * np.pi])
    np.testing.assert_allclose(model.pinocchio.lowerPositionLimit, description.limits.lower)
    np.testing.assert_allclose(world.jnt_range[:, 1], description.limits.upper)


@pytest.mark.parametrize("root", [{}, WORLD_ROOT])
def test_root_may_be_world_or_not(urdf, root):
    description, model, world = everywhere(urdf(**root))
    height = 0.4 * bool(root)
    data = mujoco.MjData(world)
    mujoco.mj_forward(world, data)
    assert model.position(np.zeros(3))[2] == pytest.approx(1.2 + height)
    assert data.geom("base_collision").xpos[2] == pytest.approx(height, abs=1e-6)
    assert {capsule.link for capsule in description.capsules} == {"base", "l1", "l2", "l3"}


def test_joints_off_the_chain_are_frozen(urdf):
    description, model, world = everywhere(urdf(**FINGER), tip="l3")
    assert description.joints == ("j1", "j2", "j3")
    assert world.nv == model.pinocchio.nv == 3
    assert ("finger", FLOOR) in description.collision_pairs


@pytest.mark.parametrize(("tip", "dof"), [("l1", 1), ("l2", 2), ("l3", 3)])
def test_an_arm_may_have_any_number_of_joints(urdf, tip, dof):
    _, model, world = everywhere(urdf(), tip=tip)
    q = np.full(dof, 0.5)
    assert world.nv == dof
    assert model.jacobian(q).shape == model.local_jacobian(q).shape == (6, dof)
    np.testing.assert_allclose(model.positions(q), model.position(q), atol=1e-12)


def test_inertia_off_the_chain_is_checked_too(urdf):
    finger = {"finger": link("finger", BOX, moment=1), "slide": FINGER["slide"]}
    with pytest.raises(ConfigurationError, match="finger"):
        everywhere(urdf(**finger), tip="l3")


def test_joints_beyond_the_tip_are_frozen(urdf):
    assert load_arm(urdf(), tip="l2").joints == ("j1", "j2")


def test_home_is_zero_or_else_mid_range(urdf):
    np.testing.assert_array_equal(load_arm(urdf(**limited(lower=0.5, upper=1.5))).home, [0, 1, 0])


@pytest.mark.parametrize("shape", [BOX, CYLINDER, SPHERE])
def test_primitives_lie_within_their_capsule_at_their_origin(urdf, shape):
    origin = '<origin xyz="0.1 0.2 0.3" rpy="0.3 0.5 0.7"/>'
    points = np.random.default_rng(0).normal(size=(2000, 3))
    if shape == BOX:
        points = np.sign(points) * [0.05, 0.05, 0.15]
    elif shape == SPHERE:
        points *= 0.05 / np.linalg.norm(points, axis=1, keepdims=True)
    else:
        points[:, :2] *= 0.05 / np.linalg.norm(points[:, :2], axis=1, keepdims=True)
        points[:, 2] = 0.15 * np.sign(points[:, 2])
    placed = Rotation.from_euler("xyz", [0.3, 0.5, 0.7]).apply(points) + np.array([0.1, 0.2, 0.3])
    arm = load_arm(urdf(l1=link("l1", shape, origin=origin)))
    capsule = next(capsule for capsule in arm.capsules if capsule.link == "l1")
    assert 0.9 * capsule.radius < outermost(capsule, placed) < 1.005 * capsule.radius  # a sphere is rings of points


@pytest.mark.parametrize("filename", ["tetra.stl", "package://robot/tetra.stl"])
def test_mesh_is_found_scaled_and_placed(tmp_path, urdf, filename):
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in np.delete(corners, i, axis=0))
        + "endloop\nendfacet\n"
        for i in range(4)
    )
    file = tmp_path / filename.removeprefix("package://")
    file.parent.mkdir(exist_ok=True)
    file.write_text(f"solid tetra\n{facets}endsolid tetra\n")
    shape = f'<mesh filename="{filename}" scale=".1 .2 .3"/>'
    description, _, _ = everywhere(urdf(l1=link("l1", shape, origin='<origin xyz="1 2 3"/>')))
    (mesh,) = (shape for shape in description.meshes if shape.link == "l1")
    np.testing.assert_allclose(
        np.unique(mesh.vertices.round(6), axis=0), np.unique(corners * [0.1, 0.2, 0.3] + [1, 2, 3], axis=0)
    )
    assert mesh.triangles.shape == (4, 3)


def test_srdf_rules_out_pairs(tmp_path, urdf):
    srdf = tmp_path / "arm.srdf"
    srdf.write_text('<robot name="small"><disable_collisions link1="l3" link2="l1" reason="Never"/></robot>')
    without, with_srdf = load_arm(urdf()).collision_pairs, load_arm(urdf(), srdf=srdf).collision_pairs
    assert set(without) - set(with_srdf) == {("l1", "l3")}


def test_an_edited_file_is_read_anew(urdf):
    load_arm(urdf())
    assert load_arm(urdf(**limited(velocity=7))).limits.velocity[1] == 7


def test_limits_and_joint_order_are_the_same_in_every_library(urdf):
    for path, options in ((urdf(**FINGER), {"tip": "l3"}), ("ur5", {})):
        description, model, world = everywhere(path, **options)
        assert list(model.pinocchio.names)[1:] == list(description.joints)
        assert [world.joint(i).name for i in range(world.njnt)] == [f"arm/{name}" for name in description.joints]
        for lower, upper in (
            (model.pinocchio.lowerPositionLimit, model.pinocchio.upperPositionLimit),
            (world.jnt_range[:, 0], world.jnt_range[:, 1]),
        ):
            np.testing.assert_allclose(lower, description.limits.lower)
            np.testing.assert_allclose(upper, description.limits.upper)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur3", "ur5", "ur10", "panda", "xarm7", "z1"])
def test_pairs_of_a_file_alone_get_apart_and_do_not_forbid_most_configurations(name):
    builtin = BUILTIN_ARMS[name]
    model = ArmModel(load_arm(arms.robot_data() / builtin.urdf, tip=builtin.tip))
    postures = model.random_configurations(np.random.default_rng(1), 500)
    links, clearance = model.links, Clearance(model)
    distances = clearance.nearest(postures, len(clearance.scene.pairs))[0].max(axis=0)
    for (kind, first, second), most in zip(clearance.scene.pairs.tolist(), distances, strict=True):
        assert kind != LINKS or most > 0.25 * (links[first]["radius"] + links[second]["radius"])
    assert model.are_free(postures).mean() > 0.25


@pytest.mark.slow
def test_pairs_are_the_same_whenever_a_file_is_read():
    builtin = BUILTIN_ARMS["xarm7"]
    pairs = []
    for _ in range(2):
        arms._read_arm.cache_clear()
        pairs.append(load_arm(arms.robot_data() / builtin.urdf).collision_pairs)
    assert pairs[0] == pairs[1]
    assert ("link5", "link7") not in pairs[0]


def test_accelerations_of_a_file_are_those_that_its_motors_can_give_at_once(urdf):
    text = urdf().read_text()
    strong, weak, weakest = (
        load_arm(urdf(text.replace('effort="50"', f'effort="{effort}"'))) for effort in (1e4, 50, 1)
    )
    assert set(strong.limits.acceleration) == {MAX_ACCELERATION}
    assert weak.limits.acceleration.max() <= MAX_ACCELERATION
    assert weak.limits.acceleration.min() > 1
    assert weakest.limits.acceleration.min() == 1
    model = ArmModel(weak).pinocchio
    data, q = model.createData(), np.random.default_rng(5).uniform(-2, 2, (200, weak.dof))
    for signs in ([1] * weak.dof, [(-1) ** i for i in range(weak.dof)]):
        torques = [pinocchio.rnea(model, data, at, np.zeros(weak.dof), weak.limits.acceleration * signs) for at in q]
        assert np.abs(torques).max() < 1.1 * 50


def test_prefixes_need_no_declaration(urdf):
    plain = urdf()
    text = plain.read_text().replace("<limit ", '<limit drake:acceleration="2.5" ', 1)
    path = plain.with_name("prefixed.urdf")
    path.write_text(text)
    arm = load_arm(path)
    assert any("drake:acceleration" in note for note in arm.notes)
    assert arm.joints == load_arm(plain).joints

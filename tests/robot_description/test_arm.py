import contextlib
import itertools
import signal
import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armctl.errors import ConfigurationError
from armctl.kinematics import ArmModel
from armctl.robot_description import BUILTIN_ARMS, load_arm
from armctl.robot_description import arm as arms
from armctl.robot_description.collision_pairs import FLOOR
from armctl.robots import build_arm_world
from armctl.simulation.worlds import world_path

BOX, CYLINDER, SPHERE = '<box size=".1 .1 .3"/>', '<cylinder radius=".05" length=".3"/>', '<sphere radius=".05"/>'
LIMIT = '<limit lower="-2" upper="2" velocity="3" effort="50"/>'


def link(name, shape, mass=1, moment=0.01, origin=""):
    inertia = f'<inertia ixx="0.01" iyy="0.01" izz="{moment}" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial><mass value="{mass}"/><origin xyz="0 0 .1"/>{inertia}</inertial>'
    return f'<link name="{name}">{inertial}<collision>{origin}<geometry>{shape}</geometry></collision></link>'


def joint(name, parent, child, kind="revolute", limit=LIMIT, axis="0 1 0"):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 .4"/><axis xyz="{axis}"/>{limit}</joint>'
    )


def continuous(limit):
    return {"j1": joint("j1", "base", "l1", "continuous", limit)}


def limited(**numbers):
    """The good arm's second joint with other limits; None leaves one out."""
    numbers = {"lower": -2, "upper": 2, "velocity": 3, "effort": 50} | numbers
    attributes = " ".join(f'{name}="{number}"' for name, number in numbers.items() if number is not None)
    return {"j2": joint("j2", "l1", "l2", limit=f"<limit {attributes}/>")}


def shaped(shape):
    return {"l1": link("l1", shape)}


GOOD = {
    "base": link("base", CYLINDER),
    "l1": link("l1", BOX),
    "l2": link("l2", CYLINDER),
    "l3": link("l3", SPHERE),
    "j1": joint("j1", "base", "l1", axis="0 0 1"),
    "j2": joint("j2", "l1", "l2"),
    "j3": joint("j3", "l2", "l3"),
}
FINGER = {"finger": link("finger", BOX), "slide": joint("slide", "l2", "finger", "prismatic")}
WORLD_ROOT = {"world": '<link name="world"/>', "fixed": joint("fixed", "world", "base", "fixed")}


@pytest.fixture
def urdf(tmp_path):
    """Writes a URDF: the good arm of three joints, with these parts in the place of its own."""

    def write(text=None, **parts):
        path = tmp_path / "arm.urdf"
        path.write_text(text or f'<robot name="small">{"".join((GOOD | parts).values())}</robot>')
        return path

    (tmp_path / "junk.stl").write_text("junk")
    return write


def everywhere(path, **options):
    """All that armctl makes of a URDF: description, Pinocchio's model and MuJoCo's."""
    description = load_arm(path, **options)
    return description, ArmModel(description), build_arm_world(description, "position")


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


@contextlib.contextmanager
def time_limit(seconds):
    def expire(*_):
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, expire)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


# Built-in arms


@pytest.mark.parametrize("robot", BUILTIN_ARMS)
def test_limits_are_the_numbers_of_the_urdf(robot):
    arm = load_arm(robot)
    file = ElementTree.parse(example_data(BUILTIN_ARMS[robot].urdf))
    limits = [file.find(f"joint[@name='{name}']/limit") for name in arm.joints]
    assert len(limits) == arm.dof
    for name in ("lower", "upper", "velocity", "effort"):
        np.testing.assert_array_equal(getattr(arm.limits, name), [float(limit.get(name)) for limit in limits])


@pytest.mark.parametrize("robot", BUILTIN_ARMS)
def test_mesh_vertices_lie_within_their_links_capsule(robot):
    arm = load_arm(robot)
    capsules = {capsule.link: capsule for capsule in arm.capsules}
    assert arm.meshes
    for mesh in arm.meshes:
        capsule = capsules[mesh.link]
        assert outermost(capsule, mesh.vertices) <= capsule.radius + 1e-9


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


@pytest.mark.parametrize(("robot", "dof"), [("z1", 6), ("panda", 7), ("xarm7", 7)])
def test_arms_that_are_no_ur(robot, dof):
    description, model, world = everywhere(robot)
    assert description.dof == model.dof == world.nv == dof
    assert model.is_free(description.home)
    assert model.within_limits(description.home)


def test_acceleration_limits_may_differ_from_joint_to_joint():
    np.testing.assert_array_equal(load_arm("panda").limits.acceleration, [15, 7.5, 10, 12.5, 15, 20, 20])
    np.testing.assert_array_equal(load_arm("panda", max_acceleration=3).limits.acceleration, np.full(7, 3.0))
    limits = load_arm("ur5", max_acceleration=np.arange(1, 7), max_jerk=[9] * 6).limits
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
    (mesh,) = description.meshes
    assert mesh.link == "l1"
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


# What is wrong with a file is said

BAD_FILES = {
    "no velocity limit": (limited(velocity=None), "'j2'.*no velocity"),
    "no effort limit": (limited(effort=None), "'j2'.*no effort"),
    "no limits": ({"j2": joint("j2", "l1", "l2", limit="")}, "'j2'.*lower.*upper"),
    "continuous without limits": (continuous(""), "'j1'.*velocity.*effort"),
    "zero effort": (limited(effort=0), "'j2'.*effort"),
    "negative velocity": (limited(velocity=-1), "'j2'.*velocity"),
    "limits swapped": (limited(lower=1, upper=-1), "'j2'.*lower"),
    "limit not a number": (limited(lower="nan"), "'j2'.*lower"),
    "limit infinite": (limited(lower="-inf"), "j2"),
    "limit a word": (limited(lower="low"), "j2"),
    "prismatic": ({"j2": joint("j2", "l1", "l2", "prismatic")}, "'j2'.*prismatic"),
    "floating": ({"j2": joint("j2", "l1", "l2", "floating")}, "'j2'.*floating"),
    "axis zero": ({"j2": joint("j2", "l1", "l2", axis="0 0 0")}, "j2"),
    "no joints that move": (
        {f"j{i}": joint(f"j{i}", parent, f"l{i}", "fixed") for i, parent in enumerate(["base", "l1", "l2"], 1)},
        "no revolute joint.*'l3'",
    ),
    "mesh missing": (shaped('<mesh filename="package://arm/none.stl"/>'), r"none\.stl"),
    "mesh corrupt": (shaped('<mesh filename="junk.stl"/>'), r"junk\.stl"),
    "shape unknown": (shaped('<cone radius="1"/>'), "cone"),
    "shape missing": (shaped(""), "without a shape"),
    "box without size": (shaped("<box/>"), "box|l1"),
    "box flat": (shaped('<box size="1 1"/>'), "box|l1"),
    "sphere without radius": (shaped("<sphere/>"), "sphere|l1"),
    "sphere inside out": (shaped('<sphere radius="-1"/>'), "sphere|l1"),
    "no mass behind a joint": ({"l2": link("l2", BOX, mass=0)}, "l2"),
    "inertia of no body": ({"l2": link("l2", BOX, moment=1)}, "l2"),
    "inertia of no body at the base": ({"base": link("base", CYLINDER, moment=1)}, "base"),
    "several leaves": (FINGER, "2 leaf links.*finger.*tip="),
    "two links of one name": ({"again": link("l1", BOX)}, "l1"),
    "two joints of one name": ({"again": joint("j1", "l3", "l4"), "l4": link("l4", BOX)}, "j1"),
    "joint to nowhere": ({"astray": joint("astray", "l3", "nowhere")}, "nowhere"),
    "joint from nowhere": ({"astray": joint("astray", "nowhere", "base")}, "nowhere"),
}


@pytest.mark.parametrize(("parts", "culprit"), BAD_FILES.values(), ids=BAD_FILES)
def test_what_is_wrong_with_a_urdf_is_named(urdf, parts, culprit):
    with pytest.raises(ConfigurationError, match=culprit):
        everywhere(urdf(**parts))


def test_a_ring_of_joints_is_refused(urdf):
    with time_limit(2), pytest.raises(ConfigurationError, match=r"arm\.urdf"):
        everywhere(urdf(ring=joint("ring", "l3", "base")), tip="l3")


@pytest.mark.parametrize(
    ("text", "culprit"),
    [
        ("junk", "cannot be read as XML"),
        ("<robot>", "cannot be read as XML"),
        ("\x00\x01\xff", "cannot be read as XML"),
        ("<sdf/>", "not a URDF.*<sdf>"),
        ('<robot name="x"/>', "0 leaf links"),
        (f"<robot>{''.join(GOOD.values())}</robot>", "name"),
    ],
)
def test_what_is_no_urdf_is_refused(urdf, text, culprit):
    with pytest.raises(ConfigurationError, match=culprit) as error:
        everywhere(urdf(text))
    assert "arm.urdf" in str(error.value)


BAD_OPTIONS = {
    "unknown tip": ({"tip": "l33"}, "'l33'.*Did you mean 'l3'"),
    "tip is the root": ({"tip": "base"}, "'base'"),
    "home too short": ({"home": [0, 0]}, r"home.*\(3,\).*\(2,\)"),
    "home empty": ({"home": []}, "home"),
    "home a table": ({"home": [[0, 0, 0]]}, "home"),
    "home out of limits": ({"home": [0, 0, 2.1]}, "home.*2.1.*limits"),
    "home not a number": ({"home": [0, 0, np.nan]}, "home.*nan"),
    "home of words": ({"home": ["up", "up", "down"]}, "home"),
    "srdf missing": ({"srdf": "none.srdf"}, r"none\.srdf"),
    "acceleration below zero": ({"max_acceleration": -1.0}, "acceleration.*-1"),
    "acceleration zero": ({"max_acceleration": 0.0}, "acceleration.*0"),
    "accelerations of other joints": ({"max_acceleration": (1.0, 2.0)}, "acceleration.*, or 3 of them"),
    "acceleration in words": ({"max_acceleration": "fast"}, "acceleration.*fast"),
    "jerk not a number": ({"max_jerk": np.nan}, "jerk.*nan"),
}


@pytest.mark.parametrize(("options", "culprit"), BAD_OPTIONS.values(), ids=BAD_OPTIONS)
def test_what_is_wrong_with_an_option_is_named(urdf, options, culprit):
    with pytest.raises(ConfigurationError, match=culprit):
        load_arm(urdf(), **options)


@pytest.mark.parametrize("home", [[], [0] * 5, [0, 0, 4, 0, 0, 0]])
def test_home_of_a_builtin_arm_is_checked_too(home):
    with pytest.raises(ConfigurationError, match="home"):
        load_arm("ur5", home=home)

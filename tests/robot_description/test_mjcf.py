"""MJCF robots: MuJoCo compiles them, and armctl's description of them moves and weighs as MuJoCo's model does."""

import mujoco
import numpy as np
import pinocchio
import pytest

from armctl.core.errors import ConfigurationError
from armctl.kinematics import ArmModel
from armctl.robot_description import load_arm, mjcf_file
from armctl.robot_description.meshes import thinness
from armctl.robots import build_arm_world
from armctl.rollout import evaluate

ARM = """
<mujoco model="odd">
  <compiler angle="degree" autolimits="true"/>
  <default><default class="motor"><joint armature="0.2" damping="0.5"/></default></default>
  <worldbody>
    <geom type="plane" size="1 1 1" material="grid"/><geom type="hfield" hfield="hills" pos="5 5 0"/>
    <geom type="box" size="1 1 .1" pos="4 0 -.1" material="layered"/>
    <body name="table" pos="2 0 0"><geom type="box" size=".1 .1 .1"/></body>
    <body name="cube" pos="1 1 1"><freejoint/><geom type="box" size=".1 .1 .1"/></body>
    <body name="base" pos="0 0 .5" euler="0 10 20">
      <geom type="cylinder" size=".08 .05"/>
      <body name="l1" pos="0 0 .1" childclass="motor">
        <joint name="j1" axis="0 0 1" range="-170 170" ref="15" pos=".01 .02 0"/>
        <geom type="capsule" fromto="0 0 0 0 0 .2" size=".05"/>
        <body name="l2" pos="0 .02 .25" quat=".9 .1 .2 .3">
          <joint name="j2" axis="0 1 .3" range="-120 120" pos="0 0 -.02"/>
          <geom type="ellipsoid" size=".05 .05 .15" pos="0 0 .15"/>
          <body name="l3" pos="0 0 .3">
            <joint name="j3" type="slide" axis="0 .2 1" range="-.1 .2" ref=".05"/>
            <geom type="box" size=".04 .04 .1" pos="0 0 .1"/>
            <body name="l4" pos="0 0 .2"><joint name="j4" axis="1 0 0"/><geom type="sphere" size=".04" pos="0 0 .06"/>
              <body name="hand" pos="0 0 .1"><geom type="box" size=".02 .05 .02"/>
                <site name="tool_tcp" pos="0 .01 .05" euler="30 0 0"/>
                <body name="finger" pos="0 0 .05"><joint name="f" type="slide" axis="0 1 0" range="0 .04"/>
                  <geom type="box" size=".01 .01 .02"/></body>
                <body name="thumb" pos="0 0 .05"><geom type="mesh" mesh="wedge" contype="0" conaffinity="0"/></body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <asset><hfield name="hills" nrow="2" ncol="2" size="1 1 .1 .1" elevation="0 1 1 0"/>
    <material name="grid" texture="t"/><material name="layered"><layer texture="t" role="rgb"/></material>
    <mesh name="wedge" vertex="0 0 0 .02 0 0 0 .02 0 0 0 .05"/><texture name="t" type="skybox" builtin="flat"
    rgb1="0 0 0" width="8" height="8"/></asset>
  <contact><exclude body1="l1" body2="l3"/></contact>
  <tendon><fixed name="pull"><joint joint="f" coef="1"/></fixed></tendon>
  <actuator>
    <motor joint="j1" ctrlrange="-3 3" gear="20"/>
    <position joint="j2" kp="100" forcerange="-50 60"/>
    <velocity joint="j3" kv="10" ctrlrange="-.3 .3" forcerange="-80 80"/>
    <position tendon="pull" kp="1"/>
  </actuator>
  <keyframe><key name="other" qpos="0 0 0 1 0 0 0 .1 .1 .1 .1 0"/>
    <key name="home" qpos="0 0 0 1 0 0 0 .3 -.4 .05 .2 .01" ctrl="0 0 0 0"/></keyframe>
</mujoco>
"""


@pytest.fixture
def write(tmp_path):
    def write(text=ARM, name="odd.xml"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


def test_limits_motors_and_home_are_those_of_the_file(write):
    arm = load_arm(write())
    assert (arm.name, arm.tip, arm.joints) == ("odd", "tool_tcp", ("j1", "j2", "j3", "j4"))
    assert arm.sliding == ("j3",)
    np.testing.assert_allclose(arm.limits.lower, [-np.radians(170), -np.radians(120), -0.1, -2 * np.pi])
    np.testing.assert_allclose(arm.limits.effort[:3], [60, 50, 80])
    np.testing.assert_allclose(arm.limits.velocity, [2, 2, 0.3, 2])
    np.testing.assert_allclose(arm.home, [0.3, -0.4, 0.05, 0.2])
    np.testing.assert_allclose(arm.armature, 0.2)
    assert {frozenset(pair) for pair in arm.collision_pairs}.isdisjoint([frozenset(("l1", "l3"))])
    notes = "\n".join(arm.notes)
    for note in (
        "Not read: <tendon>", "not part of the arm: table, cube", "'tool_tcp', by its name", "are fixed at zero: 'f'",
        "no velocity limit of these joints: 'j1', 'j2', 'j4': 2 rad/s", "no effort limit of these joints: 'j4'",
        "Damping and friction of joints are not simulated: 'j1'", "Continuous joints turn by one turn",
    ):  # fmt: skip
        assert note in notes


def test_it_moves_and_weighs_as_mujocos_model(write):
    path = write()
    arm, original = load_arm(path), mujoco.MjModel.from_xml_path(str(path))
    model, data, world = ArmModel(arm), mujoco.MjData(original), build_arm_world(arm, "torque")
    copy = mujoco.MjData(world)
    qpos, dofs = ([original.joint(name).id for name in arm.joints] for _ in range(2))
    qpos = original.jnt_qposadr[qpos]
    dofs = original.jnt_dofadr[dofs]
    mass, copied_mass = np.zeros((original.nv, original.nv)), np.zeros((4, 4))
    for q in model.random_configurations(np.random.default_rng(0), 20):
        data.qpos[qpos] = copy.qpos[:] = q
        mujoco.mj_forward(original, data)
        mujoco.mj_forward(world, copy)
        site = data.site("tool_tcp")
        np.testing.assert_allclose(model.pose(q)[:3, 3], site.xpos, atol=1e-9)
        np.testing.assert_allclose(model.pose(q)[:3, :3].ravel(), site.xmat, atol=1e-9)
        np.testing.assert_allclose(copy.body("arm/tool_tcp").xpos, site.xpos, atol=1e-9)
        gravity = pinocchio.computeGeneralizedGravity(model.pinocchio, model.pinocchio.createData(), q)
        np.testing.assert_allclose(gravity, data.qfrc_bias[dofs], atol=1e-7)
        np.testing.assert_allclose(copy.qfrc_bias, data.qfrc_bias[dofs], atol=1e-7)
        mujoco.mj_fullM(original, data, mass)
        mujoco.mj_fullM(world, copy, copied_mass)
        np.testing.assert_allclose(copied_mass, mass[np.ix_(dofs, dofs)], atol=1e-7)
        upper = np.triu(pinocchio.crba(model.pinocchio, model.pinocchio.createData(), q))
        np.testing.assert_allclose(upper, np.triu(copied_mass), atol=1e-7)


def test_capsules_enclose_all_geoms_that_collide(write):
    arm = load_arm(write())
    assert [capsule.link for capsule in arm.capsules] == ["base", "l1", "l2", "l3", "l4", "hand", "finger"]
    (ball,) = (capsule for capsule in arm.capsules if capsule.link == "l4")
    np.testing.assert_allclose(ball.start, [0, 0, 0.06], atol=2e-3)
    assert 0.04 <= ball.radius < 0.042
    assert {shape.link for shape in arm.meshes} >= {"l1", "thumb"}


def test_a_screen_without_thickness_is_drawn(write):
    flat = '<mesh name="flat" vertex="0 0 0 .1 0 0 0 .1 0 .1 .1 0" face="0 1 2 1 3 2" inertia="shell"/>'
    screen = '<geom type="mesh" mesh="flat" contype="0" conaffinity="0"/><geom type="mesh" mesh="wedge"'
    arm = load_arm(write(ARM.replace("<asset>", f"<asset>{flat}").replace('<geom type="mesh" mesh="wedge"', screen)))
    world = build_arm_world(arm, "position")
    assert sum(geom == mujoco.mjtGeom.mjGEOM_MESH for geom in world.geom_type) == len(arm.meshes)
    assert any(thinness(shape.vertices) for shape in arm.meshes)


def test_a_body_or_another_site_may_be_the_tip(write):
    assert load_arm(write(), tip="l4").joints == ("j1", "j2", "j3", "j4")
    assert load_arm(write(ARM.replace("tool_tcp", "grasp")), tip="grasp").tip == "grasp"
    with pytest.warns(UserWarning, match="taken to be 'hand', all other links that move are behind it"):
        assert load_arm(write(ARM.replace("tool_tcp", "grasp"))).tip == "hand"


def test_included_files_and_meshes_are_read_in_the_package(write, tmp_path):
    (tmp_path / "parts").mkdir()
    obj = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "parts" / "Wedge.obj").write_text(obj)
    write(ARM.replace('vertex="0 0 0 .02 0 0 0 .02 0 0 0 .05"', 'file="wedge.obj"').replace(
        "<compiler", '<compiler meshdir="parts"'
    ))  # fmt: skip
    scene = write('<mujoco><include file="odd.xml"/><worldbody><light pos="0 0 1"/></worldbody></mujoco>', "scene.xml")
    arm = load_arm(scene)
    thumb = next(shape for shape in arm.meshes if shape.link == "thumb")
    assert np.ptp(thumb.vertices, axis=0).max() == pytest.approx(0.1)


def nested(count):
    """That many joints, each on the body before it."""
    bodies = "".join(f'<body><joint name="j{i}"/><geom size=".1"/>' for i in range(count))
    return f"<mujoco><worldbody>{bodies}{'</body>' * count}</worldbody></mujoco>"


HOSTILE = {
    "entities": ('<!DOCTYPE m [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]><mujoco model="&b;"/>', "document type"),
    "no MJCF": ("<sdf/>", "is not a URDF or MJCF: its root element is <sdf>"),
    "nothing in it": ("<mujoco/>", "no revolute joint"),
    "not a number": (ARM.replace('pos="0 0 .5"', 'pos="0 0 nan"'), "base_fixed.*'nan' is not a finite number"),
    "letters": (ARM.replace('pos="0 0 .5"', 'pos="0 0 up"'), "MuJoCo does not compile it"),
    "no mass": (ARM.replace('<geom type="ellipsoid" size=".05 .05 .15" pos="0 0 .15"/>', ""), "l2"),
    "deep": (nested(1_000), "more than 100 elements within each other"),
    "a million joints": (
        f"<mujoco><worldbody>{'<body><joint/></body>' * 30_000}</worldbody></mujoco>", "elements; at most 20000",
    ),
    "many copies": (ARM.replace("<worldbody>", '<worldbody><replicate count="1000000000"/>'), "<replicate>"),
    "plug-in": (ARM.replace("<worldbody>", '<worldbody><plugin plugin="x"/>'), "<plugin>"),
    "mesh elsewhere": (
        ARM.replace('vertex="0 0 0 .02 0 0 0 .02 0 0 0 .05"', 'file="../../../etc/hostname"'), "outside|was not found",
    ),
    "mesh missing": (ARM.replace('vertex="0 0 0 .02 0 0 0 .02 0 0 0 .05"', 'file="none.stl"'), r"none\.stl"),
    "mesh without any": (ARM.replace('vertex="0 0 0 .02 0 0 0 .02 0 0 0 .05"', 'builtin="sphere"'), "neither a file"),
    "includes itself": ('<mujoco><include file="odd.xml"/></mujoco>', "odd.xml includes 'odd.xml' twice"),
    "includes elsewhere": ('<mujoco><include file="../../x.xml"/></mujoco>', "no file in its package"),
    "two joints of one body": (
        ARM.partition("<keyframe>")[0].replace('<joint name="j4"', '<joint/><joint name="j4"') + "</mujoco>",
        "2 joints of one body",
    ),
    "ball": (
        ARM.replace('name="j4" axis="1 0 0"', 'name="j4" type="ball"').partition("<keyframe>")[0] + "</mujoco>",
        "'j4' is ball",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("text", "culprit"), HOSTILE.values(), ids=HOSTILE)
def test_what_is_wrong_with_an_mjcf_is_one_line(write, text, culprit):
    with pytest.raises(ConfigurationError, match=culprit) as error:
        load_arm(write(text))
    assert "\n" not in str(error.value)
    assert "odd.xml" in str(error.value)


def test_files_that_include_each_other_without_end_are_refused(write, tmp_path):
    write('<mujoco><include file="b.xml"/></mujoco>', "a.xml")
    write('<mujoco><include file="a.xml"/></mujoco>', "b.xml")
    with pytest.raises(ConfigurationError, match=r"includes 'a\.xml' twice"):
        load_arm(tmp_path / "a.xml")
    for i in range(mjcf_file.MAX_FILES + 2):
        write(f'<mujoco><include file="{i + 1}.xml"/></mujoco>', f"{i}.xml")
    with pytest.raises(ConfigurationError, match="or more than 50 files"):
        load_arm(tmp_path / "0.xml")


def test_a_robot_of_menagerie_is_found_by_its_name(write, monkeypatch, tmp_path):
    pytest.importorskip("mujoco_menagerie")
    folder = tmp_path / "universal_robots_ur5e"
    folder.mkdir()
    (folder / "scene.xml").write_text(ARM)
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
    assert load_arm("menagerie:universal_robots_ur5e").name == "odd"
    with pytest.raises(ConfigurationError, match=r"cannot be had.*ur5e"):
        load_arm("menagerie:universal_robots_ur5f")


def test_without_menagerie_a_copy_of_robot_descriptions_is_taken_or_the_package_named(monkeypatch, tmp_path):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path))
    with pytest.raises(ConfigurationError, match="pip install mujoco-menagerie"):
        load_arm("menagerie:odd")
    (tmp_path / "mujoco_menagerie" / "odd").mkdir(parents=True)
    (tmp_path / "mujoco_menagerie" / "odd" / "scene.xml").write_text(ARM)
    assert load_arm("menagerie:odd").name == "odd"


@pytest.mark.slow
def test_experts_reach_with_an_mjcf_robot(write):
    results = evaluate(
        "reach_ik", "armctl/ArmReach-v0", episodes=2, seed=0, worlds=2, env_options={"robot": str(write())},
        lower_bound_steps=False,
    )  # fmt: skip
    assert results.success.all()

"""What armctl repairs, leaves out or assumes about a robot's file is told: on load, in results, in their identity."""

import re
import warnings

import mujoco
import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.kinematics import ArmModel
from armctl.robot_description import BUILTIN_ARMS, load_arm
from armctl.robot_description.arm import robot_data

from ..command_line import armctl as in_process
from .small_arm import BOX, chain_of, everywhere, joint, link

Z, Y, X = "0 0 1", "0 1 0", "1 0 0"


def noted(path, **options):
    """All notes about a robot, as one text."""
    return "\n".join(load_arm(path, **options).notes)


@pytest.mark.one_case
@pytest.mark.parametrize("name", BUILTIN_ARMS)
def test_named_arms_have_no_notes(name):
    assert load_arm(name).notes == ()


def test_notes_are_warned_of_once_when_a_file_is_read(urdf):
    path = urdf(chain_of([Z, Y]))
    with pytest.warns(UserWarning, match="2 of the 6 directions"):
        arm = load_arm(path)
    with warnings.catch_warnings(action="error"):
        assert load_arm(path) is arm


def test_notes_are_in_results_and_in_their_identity(urdf, tmp_path):
    path = urdf(chain_of([Z, Y, Y]))
    (note,) = (note for note in load_arm(path).notes if "directions" in note)
    for run in range(2):  # the second finds all episodes played
        result = armctl.compare(["random"], episodes=1, out=tmp_path / "out", env_options={"robot": str(path)})
        assert note in result.notes, run
        assert note in result.identity["notes"]


def test_named_robots_and_environments_of_others_add_nothing():
    for env in ("armctl/ArmReach-v0", "armctl/BridgeCross-v0", "CartPole-v1"):
        assert not make_worlds(env, 1).remarks


@pytest.mark.parametrize(
    ("axes", "says"),
    [
        ([Z], r"joints \(1\) command 1 of the 6 directions.*position 0 of 3"),
        ([Z, Y], r"joints \(2\) command 2 of"),
        ([Z, Y, Y, Y, Z], r"joints \(5\) command 5 of"),
        ([Z, Y, Y, Y, Z, Z], r"joints \(6\) command 5 of"),
        ([Z, Y, Y, Y, Y, Y], r"joints \(6\) command 4 of"),
        ([Y, Y, Y, Y], r"joints \(4\) command 3 of.*position 2 of 3"),
        ([Z, Y, Y, Z, Y, Z], None),
    ],
)
def test_directions_that_an_arm_cannot_command_are_told(urdf, axes, says):
    notes = noted(urdf(chain_of(axes)))
    assert ("directions" in notes) == (says is not None)
    if says:
        with pytest.warns(UserWarning, match=says):
            load_arm(urdf(chain_of(axes) + "\n"))


def rotated(moments, rng):
    """An inertia with these principal moments, as CAD programs write it."""
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    (xx, xy, xz), (_, yy, yz), (*_, zz) = (turn @ np.diag(moments) @ turn.T).tolist()
    return f'<inertia ixx="{xx!r}" iyy="{yy!r}" izz="{zz!r}" ixy="{xy!r}" ixz="{xz!r}" iyz="{yz!r}"/>'


@pytest.mark.one_case
@pytest.mark.parametrize(("excess", "outcome"), [(0, ""), (1e-9, "raised"), (9e-7, "raised"), (0.04, "raised")])
@pytest.mark.parametrize("seed", range(5))
def test_the_inertia_of_a_plate_is_taken_and_one_a_little_beyond_is_mended(urdf, excess, outcome, seed):
    inertia = rotated([0.001, 0.002, 0.003 * (1 + excess)], np.random.default_rng(seed))
    before, _, after = link("l1", BOX).partition("<inertia ")
    path = urdf(l1=before + inertia + after.partition("/>")[2])
    _, _, world = everywhere(path)
    assert ("'l1' has principal moments" in noted(path)) == bool(outcome)
    np.testing.assert_allclose(np.sort(world.body("arm/l1").inertia), [0.001, 0.002, 0.003], rtol=4 * excess + 1e-9)


def test_an_inertia_far_beyond_is_refused(urdf):
    with pytest.raises(ConfigurationError, match="'l1' has an impossible inertia"):
        load_arm(urdf(l1=link("l1", BOX, moment=0.022)))


def mounted(xyz, rpy="0 0 0", axes=(Z, Y, Y, X, Y, X)):
    """A chain on a mount."""
    mount = joint("mount", "mount_base", "base", "fixed", limit="")
    mount = mount.replace('xyz="0 0 .4"', f'xyz="{xyz}" rpy="{rpy}"')
    chain = chain_of(axes, length=0.2)
    return chain.replace('<link name="base">', f'<link name="mount_base"/>{mount}<link name="base">')


IN_FLOOR = {
    "leaning": (mounted("0 0 0.6", "0 2.2 0"), "'l6' by 0.17 m"),
    "lying": (mounted("0 0 0.01", "0 1.5708 0"), "'l1' by 0.02 m"),
    "below": (mounted("0 0 -1.5"), "'l2' by 1.2 m.*'l6'"),
}


@pytest.mark.parametrize(("text", "culprit"), IN_FLOOR.values(), ids=IN_FLOOR)
def test_a_home_in_the_floor_is_refused(urdf, text, culprit):
    with pytest.raises(ConfigurationError, match=f"begins in the floor.*{culprit}.*home"):
        load_arm(urdf(text), home=np.zeros(6))


def test_an_arm_that_is_in_the_floor_at_any_home_is_refused(urdf):
    for text in (mounted("0 0 -1.5"), mounted("0 0 0.01", "0 1.5708 0")):
        with pytest.raises(ConfigurationError, match="begins in the floor"):
            load_arm(urdf(text))


def test_where_no_home_is_given_one_above_the_floor_is_chosen_and_told(urdf):
    arm = load_arm(urdf(mounted("0 0 0.6", "0 2.2 0")))
    (note,) = (note for note in arm.notes if "in the floor" in note)
    assert "'l6' by 0.17 m" in note
    assert ", ".join(f"{position:g}" for position in arm.home) in note
    assert ArmModel(arm).is_free(arm.home)
    by_path = load_arm(robot_data() / BUILTIN_ARMS["ur5"].urdf, tip="ee_link")
    assert "'wrist_2_link' by 0.068 m, 'wrist_3_link'" in "".join(by_path.notes)
    assert {link for pair in by_path.collision_pairs for link in pair} >= {"wrist_3_link", "(floor)"}


def test_another_home_helps_also_from_the_command_line(urdf):
    path, home = urdf(mounted("0 0 0.6", "0 2.2 0")), (0, -1.0, 0, 0, 0, 0)
    envs = make_worlds("armctl/ArmReach-v0", 1, {"robot": str(path), "home": list(home)})
    np.testing.assert_array_equal(envs.task.robot.home, home)


UPRIGHT, HANGING, TILTED, WALL = ("0 0 0", "0 0 0"), ("0 0 0.7", "3.14159265358979 0 0"), ("0 0 0.15", "1 0 0"), (
    "0 0 0.3", "1.5708 0 0",
)  # fmt: skip


@pytest.mark.one_case
@pytest.mark.parametrize("mount", [UPRIGHT, HANGING, TILTED, WALL])
def test_no_link_passes_through_the_floor_unseen(urdf, mount):
    home = [0, 1.5 * (mount is HANGING), 0, 0, 0, 0]
    arm, model, world = everywhere(urdf(mounted(*mount)), home=home)
    data = mujoco.MjData(world)
    low = 0
    for data.qpos[:] in model.random_configurations(np.random.default_rng(0), 300):
        mujoco.mj_forward(world, data)
        ends = [world.geom(i).name for contact in data.contact for i in contact.geom]
        for capsule in arm.capsules:
            geom = data.geom(f"{capsule.link}_collision")
            axis = geom.xmat.reshape(3, 3)[:, 2] * world.geom(geom.id).size[1]
            depth = world.geom(geom.id).size[0] + abs(axis[2]) - geom.xpos[2]
            if depth > 1e-3 and capsule.link != "base" and not (capsule.link == "l1" and mount is UPRIGHT):
                low += 1
                assert geom.name in ends
                assert "floor" in ends
                assert not model.is_free(data.qpos)
    assert low > 20


def test_links_that_are_left_out_of_contacts_are_told(urdf):
    folded = noted(urdf(mounted("0 0 1").replace('"2"', '"3"')), home=[0, 0, 3, 0, 0, 0])
    assert "'l1' with 'l5'" in folded
    assert "touch each other at home" in folded
    assert "Contacts" not in noted(urdf(mounted("0 0 0")))
    shipped = noted(robot_data() / BUILTIN_ARMS["panda"].urdf, tip="panda_hand_tcp")
    assert "'panda_link5' with 'panda_link7'" in shipped
    assert "'panda_link2' with 'panda_link4'" in shipped
    assert "near each other in all postures" in shipped


def test_an_srdf_about_links_that_the_arm_does_not_have_rules_nothing_out(urdf, tmp_path):
    srdf = tmp_path / "arm.srdf"
    srdf.write_text('<robot name="chain"><disable_collisions link1="gripper" link2="l3"/></robot>')
    path = urdf(mounted("0 0 0"))
    assert load_arm(path, srdf=srdf).collision_pairs == load_arm(path).collision_pairs


def test_a_first_link_in_the_floor_that_only_turns_is_told(urdf):
    assert "Link 'l1' is in the floor" in noted(urdf(mounted("0 0 -0.15")), home=[0, 0.2, 0, 0, 0, 0])


def chain(**changes):
    """A chain of six joints about Z, Y, Y, X, Y, X; `changes` are texts in place of others, of the second joint."""
    text = chain_of([Z, Y, Y, X, Y, X], length=0.2)
    second = joint("j2", "l1", "l2", axis=Y).replace("0 0 .4", "0 0 0.2")
    assert second in text
    changed = second
    for old, new in changes.values():
        assert old in changed
        changed = changed.replace(old, new)
    return text.replace(second, changed)


def test_joints_beside_the_chain_are_told(urdf):
    finger = joint("finger", "l6", "pad", "prismatic", '<limit lower="0.01" upper="0.04" velocity="1" effort="1"/>')
    second = joint("second", "l6", "pad2", "prismatic").replace("</joint>", '<mimic joint="finger"/></joint>')
    links = '<link name="pad"/><link name="pad2"/>'
    notes = noted(urdf(chain().replace("</robot>", f"{links}{finger}{second}</robot>")), tip="tool")
    assert "Joints beside the chain from root to tip are fixed at zero: 'finger', 'second'." in notes
    assert "out of the range of these: 'finger'." in notes


ODD = {
    "degrees": (
        {"limit": ('lower="-2" upper="2"', 'lower="-170" upper="170"')},
        "'j2' turns up to 170 rad, 27 turns.*degr",
    ),
    "degrees of one side": ({"limit": ('upper="2"', 'upper="90"')}, "'j2' turns up to 90 rad"),
    "degrees per second": (
        {"limit": ('velocity="3"', 'velocity="120"')},
        "'j2' turns at up to 120 rad/s.*degrees per sec",
    ),
    "origin in degrees": ({"at": ('<origin xyz="0 0 0.2"', '<origin xyz="0 0 0.2" rpy="0 0 90"')}, "turned by 90 rad"),
    "weak": (
        {"limit": ('effort="50"', 'effort="0.5"')},
        r"'j2' needs up to .* N m against gravity, and may use 0.5 N m",
    ),
    "soft limits": (
        {
            "more": (
                "</joint>",
                '<safety_controller soft_lower_limit="-1" soft_upper_limit="1" k_velocity="1"/></joint>',
            )
        },
        "Soft limits .*'j2'",
    ),
    "damping": ({"more": ("</joint>", '<dynamics damping="1"/></joint>')}, "Damping .*'j2'"),
    "friction": ({"more": ("</joint>", '<dynamics friction="1"/></joint>')}, "friction .*'j2'"),
    "no axis": ({"axis": ('<axis xyz="0 1 0"/>', "")}, "without an <axis> .* x.*'j2'"),
    "continuous": ({"kind": ("revolute", "continuous")}, "Continuous joints turn by one turn .*'j2'"),
    "unit of a limit": ({"limit": ("<limit ", '<limit unit="deg" ')}, "Not read: unit='deg' of <limit>"),
    "acceleration": ({"limit": ("<limit ", '<limit acceleration="5" ')}, "acceleration='5' of <limit>"),
    "quaternion": ({"at": ("<origin ", '<origin quat_xyzw="1 0 0 0" ')}, "quat_xyzw='1 0 0 0' of <origin>"),
    "unknown element": ({"more": ("</joint>", "<backlash/></joint>")}, "Not read: <backlash>"),
}


@pytest.mark.one_case
@pytest.mark.parametrize(("changes", "says"), ODD.values(), ids=ODD)
def test_what_is_odd_is_told_and_what_is_not_is_not(urdf, changes, says):
    with pytest.warns(UserWarning, match=says):
        arm = load_arm(urdf(chain(**changes)))
    (note,) = (note for note in arm.notes if not note.startswith("Assumed"))
    assert re.search(says, note)


@pytest.mark.parametrize("harmless", ["", '<dynamics damping="0"/>', '<calibration rising="0"/>', "<!-- a remark -->"])
def test_an_ordinary_file_has_only_assumptions_noted(urdf, harmless):
    notes = noted(urdf(chain(more=("</joint>", f"{harmless}</joint>"))))
    assert notes == (
        "Assumed, since the file does not say: home (rad) 0, 0, 0, 0, 0, 0; acceleration limits (rad/s^2) 15, 8.48, "
        "15, 15, 15, 15; jerk limits (rad/s^3) 300."
    )
    assert not noted(urdf(chain()), home=np.zeros(6), max_acceleration=10, max_jerk=100)


@pytest.mark.parametrize(("factor", "says"), [(1000, "is 1.2e+03 m long"), (0.01, "is 0.012 m long"), (1, "")])
def test_lengths_in_other_units_are_suspected(urdf, factor, says):
    text = chain().replace('xyz="0 0 0.2"', f'xyz="0 0 {0.2 * factor:g}"')
    text = text.replace('radius=".03" length="0.12"', f'radius="{0.03 * factor:g}" length="{0.12 * factor:g}"')
    notes = noted(urdf(text), home=[0, 0.3, 0.3, 0, 0, 0])
    assert says in notes
    assert ("URDFs are in metres" in notes) == bool(says)


def test_shapes_in_millimetres_on_an_arm_in_metres_are_suspected(urdf):
    text = chain().replace('length="0.12"', 'length="120"').replace('radius=".03"', 'radius="30"')
    with pytest.raises(ConfigurationError, match="in the floor"):
        load_arm(urdf(text))
    upper = link("l6", '<cylinder radius="2" length="10"/>')
    assert "Link 'l6' is" in noted(
        urdf(mounted("0 0 12").replace(link("l6", '<cylinder radius=".03" length="0.12"/>'), upper))
    )


LEFTOVERS = {
    "macro": ("</robot>", '<xacro:gripper parent="tool"/></robot>'),
    "property": ("<link ", '<xacro:property name="speed" value="2"/><link '),
    "old namespace": ("</robot>", '<x:arm xmlns:x="http://ros.org/wiki/xacro"/></robot>'),
    "expression": ('velocity="3"', 'velocity="${speed}"'),
    "argument": ('velocity="3"', 'velocity="$(arg speed)"'),
    "path": ('<cylinder radius=".03" length="0.12"/>', '<mesh filename="file://$(find own)/l.stl"/>'),
}


@pytest.mark.one_case
@pytest.mark.parametrize("declared", [True, False])
@pytest.mark.parametrize(("old", "new"), LEFTOVERS.values(), ids=LEFTOVERS)
def test_leftovers_of_xacro_are_refused(urdf, old, new, declared):
    space = ' xmlns:xacro="http://www.ros.org/wiki/xacro"' if declared else ""
    text = chain().replace('<robot name="chain">', f'<robot name="chain"{space}>')
    load_arm(urdf(text))  # the name space alone is in every file that xacro has written
    with pytest.raises(
        ConfigurationError, match=r"arm\.urdf is a xacro file, or has leftovers.*xacro arm\.urdf\.xacro >"
    ):
        load_arm(urdf(text.replace(old, new, 1)))


def test_without_xacrodoc_a_xacro_file_is_named_as_one(tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    (tmp_path / "arm.urdf.xacro").write_text("<robot/>")
    with pytest.raises(ConfigurationError, match="is a xacro file"):
        load_arm(tmp_path / "arm.urdf.xacro")


def test_elements_beside_links_and_joints_are_told(urdf):
    extra = '<gripper parent="tool"/><loop_joint name="l"/><transmission name="t"/><material name="grey"/>'
    notes = noted(
        urdf(chain().replace("</robot>", f"{extra}</robot>").replace('name="chain"', 'name="chain" units="mm"'))
    )
    assert "Not read: <gripper>, <loop_joint>, units='mm' of <robot>." in notes


def test_list_shows_a_robot_with_its_notes(urdf):
    path = urdf(chain(limit=('velocity="3"', 'velocity="120"')))
    shown = " ".join(in_process("list", "--robot", str(path), cwd=path.parent).stdout.split())
    assert "j2 -2 to 2 rad, 120 rad/s, 50 N m, home 0" in shown
    assert all(note in shown for note in load_arm(path).notes)
    assert "notes none" in " ".join(in_process("list", "--robot", "ur5", cwd=path.parent).stdout.split())

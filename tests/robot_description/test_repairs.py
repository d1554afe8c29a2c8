"""Files as they are found: what is missing or impossible is completed, told, and does not move the arm elsewhere."""

import itertools

import numpy as np
import pinocchio
import pytest

from armctl.core.errors import ConfigurationError
from armctl.kinematics import ArmModel
from armctl.robot_description import load_arm
from armctl.robot_description.effort import torques_of
from armctl.robot_description.inertia import solid_inertia

from .small_arm import BOX, FINGER, GOOD, LIMIT, SPHERE, chain_of, continuous, everywhere, joint, limited, link
from .test_negligible_links import INERTIAS, with_inertia

BARE = {name: f'<link name="{name}"><collision><geometry>{BOX}</geometry></collision></link>' for name in ("l1", "l2")}
BARE["l3"] = f'<link name="l3"><collision><geometry>{SPHERE}</geometry></collision></link>'


def frame(mass, inertia, offset="0 0.3 0"):
    """A link that is fixed to the good arm's second one."""
    to_frame = joint("to_extra", "l2", "extra", "fixed", limit="").replace("0 0 .4", offset)
    return {"extra": with_inertia(link("extra", BOX, mass=mass), inertia), "to_extra": to_frame}


REPAIRED = {
    "no velocity": (limited(velocity=0), "no velocity limit of these joints: 'j2': 2 rad/s"),
    "zero effort": (limited(effort=0), "no effort limit of these joints: 'j2'.* N m"),
    "endless without limits": (continuous(""), "no effort limit of these joints: 'j1'"),
    "no masses": (BARE, "filled at 1000 kg/m.3: 'l1', 'l2', 'l3'"),
    "plate that is too thin": ({"l2": link("l2", BOX, moment=0.0208)}, "'l2' has principal moments .* raised"),
    "point on a link": (frame(1, INERTIAS["zero"]), "added up: 'l2', 'extra', to that of 'l2'"),
    "link without mass below one with mass": (
        {**frame(1, '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'), "l2": link("l2", BOX, mass=0)},
        "added up: 'extra', to that of 'l2'",
    ),
}


@pytest.mark.parametrize(("parts", "says"), REPAIRED.values(), ids=REPAIRED)
def test_a_repaired_arm_moves_as_its_file_says(urdf, parts, says):
    path = urdf(**parts)
    with pytest.warns(UserWarning, match=says):
        arm = load_arm(path, tip="l3")
    model, (_, _, world) = ArmModel(arm), everywhere(path, tip="l3")
    assert world.nu == 2 * arm.dof
    original = pinocchio.buildModelFromXML(path.read_text())
    data, tip = original.createData(), original.getFrameId("l3")
    for q in model.random_configurations(np.random.default_rng(0), 20):
        # Pinocchio has cosine and sine for a joint that turns without end
        full = np.concatenate([
            q[[i]] if size == 1 else [np.cos(q[i]), np.sin(q[i])] for i, size in enumerate(list(original.nqs)[1:])
        ])  # fmt: skip
        pinocchio.framesForwardKinematics(original, data, full)
        np.testing.assert_allclose(model.pose(q), data.oMf[tip].homogeneous, atol=1e-12)


def test_adding_up_changes_neither_weight_nor_inertia(urdf):
    inertia = '<inertia ixx="0.01" iyy="0.01" izz="0.025" ixy="0" ixz="0" iyz="0"/>'
    path = urdf(**frame(2, inertia), l2=link("l2", BOX, moment=0.015))
    arm = load_arm(path, tip="l3")
    assert "added up: 'l2', 'extra'" in "".join(arm.notes)
    repaired, original = ArmModel(arm).pinocchio, pinocchio.buildModelFromXML(path.read_text())
    for q in ArmModel(arm).random_configurations(np.random.default_rng(0), 10):
        ours, theirs = (np.triu(pinocchio.crba(model, model.createData(), q)) for model in (repaired, original))
        np.testing.assert_allclose(ours, theirs, atol=1e-12)
        ours, theirs = (
            pinocchio.computeGeneralizedGravity(model, model.createData(), q) for model in (repaired, original)
        )
        np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_velocities_and_efforts_of_options_lower_a_files_and_stand_in_for_missing_ones(urdf):
    path = urdf(**limited(velocity=None, effort=0))
    limits = load_arm(path, max_velocity=2.5, max_effort=[20, 30, 400]).limits
    np.testing.assert_array_equal(limits.velocity, [2.5, 2.5, 2.5])
    np.testing.assert_array_equal(limits.effort, [20, 30, 50])
    assert load_arm(path, max_velocity=9).limits.velocity.tolist() == [3, 9, 3]


def test_assumed_efforts_hold_the_arm_everywhere(urdf):
    arm = load_arm(urdf(**limited(effort=None), j3=joint("j3", "l2", "l3", limit='<limit lower="-2" upper="2"/>')))
    most = np.max([gravity for gravity, _ in torques_of(ArmModel(arm).pinocchio, 100)], axis=0)
    assert (arm.limits.effort[1:] > most[1:]).all()
    assert (arm.limits.acceleration >= 4.5).all()
    assert "cannot hold itself" not in "".join(arm.notes)


@pytest.mark.parametrize("density", [None, 500])
def test_masses_are_those_of_filled_shapes(urdf, density):
    path = urdf(**BARE)
    _, _, world = everywhere(path, density=density) if density else everywhere(path)
    density = density or 1000
    assert world.body("arm/l1").mass == pytest.approx(density * 0.003)
    np.testing.assert_allclose(np.sort(world.body("arm/l1").inertia) * 12, density * 0.003 * np.array([0.02, 0.1, 0.1]))
    sphere = density * 4 / 3 * np.pi * 0.05**3
    assert world.body("arm/l3").mass == pytest.approx(sphere, rel=0.05)


def test_an_impossible_inertia_is_replaced_if_a_density_is_given(urdf):
    path = urdf(l2=link("l2", BOX, mass=6, moment=1))
    with pytest.raises(ConfigurationError, match=r"'l2' has an impossible inertia.*density"):
        load_arm(path)
    arm, _, world = everywhere(path, density=700)
    assert "'l2' has an impossible inertia: it has that of its shapes" in "".join(arm.notes)
    assert world.body("arm/l2").mass == pytest.approx(6)
    np.testing.assert_allclose(np.sort(world.body("arm/l2").inertia), [0.01, 0.05, 0.05], rtol=1e-6)


def test_a_box_filled_is_pinocchios():
    rng = np.random.default_rng(0)
    size, placement = np.array([0.1, 0.2, 0.4]), pinocchio.SE3.Random()
    corners = np.array(list(itertools.product((-0.5, 0.5), repeat=3))) * size
    inner = rng.uniform(-0.5, 0.5, (20, 3)) * size
    vertices = np.vstack([inner, corners]) @ placement.rotation.T + placement.translation
    expected = placement.act(pinocchio.Inertia.FromBox(8.0, *size))
    np.testing.assert_allclose(solid_inertia(vertices, 1000).matrix(), expected.matrix(), atol=1e-10)


TIPS = {
    "tool0": ("tool0", "flange"),
    "left/gripper_tcp": ("left/gripper_tcp", "ee_link", "pad"),
    "wrist_ee_link": ("wrist_ee_link", "pad"),
}


@pytest.mark.parametrize("names", TIPS.values(), ids=TIPS)
def test_of_several_leaves_the_usual_end_effector_is_taken_and_told(urdf, names):
    parts = {name: f'<link name="{name}"/>' + joint(f"to_{name}", "l3", name, "fixed", limit="") for name in names}
    with pytest.warns(UserWarning, match=f"end-effector is taken to be '{names[0]}', by its name"):
        assert load_arm(urdf(**parts)).tip == names[0]
    assert load_arm(urdf(**parts), tip="l3").tip == "l3"


HAND = "".join(
    f'<link name="{name}"/>{joint(name, "l6", name, "prismatic", limit=LIMIT)}' for name in ("left", "right")
)


def test_without_a_usual_name_what_carries_the_fingers_is_the_end_effector_of_an_arm(urdf):
    text = chain_of(["0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0"], length=0.2)
    text = text[: text.index('<link name="tool"/>')] + HAND + "</robot>"
    with pytest.warns(UserWarning, match="taken to be 'l6', all other links that move are behind it"):
        assert load_arm(urdf(text)).tip == "l6"


def test_of_several_usual_names_on_one_path_the_last_is_taken(urdf):
    links = [("wrist_tool_link", "l3"), ("hand_tool_link", "wrist_tool_link"), ("camera", "l3")]
    parts = {
        name: f'<link name="{name}"/>{joint(f"to_{name}", parent, name, "fixed", limit="")}' for name, parent in links
    }
    assert load_arm(urdf(**parts)).tip == "hand_tool_link"


def test_a_robot_without_a_name_has_that_of_its_file(urdf):
    arm = load_arm(urdf(f"<robot>{''.join(GOOD.values())}</robot>"))
    assert arm.name == "arm"
    assert arm.notes[0] == "The robot has no name: it is called 'arm', as its file."


def test_a_capsule_is_read(urdf):
    arm = load_arm(urdf(l1=link("l1", '<capsule radius=".05" length=".2"/>')))
    (capsule,) = (capsule for capsule in arm.capsules if capsule.link == "l1")
    assert 0.05 <= capsule.radius < 0.052
    np.testing.assert_allclose(sorted([capsule.start[2], capsule.end[2]]), [-0.1, 0.1], atol=5e-3)


def test_of_two_arms_one_is_chosen_by_its_tip(urdf):
    text = "".join(part.replace('="l', '="right_l').replace('="j', '="right_j') for part in GOOD.values())
    right = text.partition("</link>")[2]
    tcps = "".join(
        f'<link name="{side}tcp"/>{joint(f"to_{side}tcp", f"{side}l3", f"{side}tcp", "fixed", limit="")}'
        for side in ("", "right_")
    )
    path = urdf(two=right + tcps)
    with pytest.raises(ConfigurationError, match=r"2 likely end-effectors .tcp, right_tcp.*tip="):
        load_arm(path)
    arm = load_arm(path, tip="right_tcp")
    assert arm.joints == ("right_j1", "right_j2", "right_j3")
    assert "beside the chain from root to tip are fixed at zero: 'j1', 'j2', 'j3'" in "".join(arm.notes)


def test_without_a_usual_name_the_tip_is_asked_for(urdf):
    with pytest.raises(ConfigurationError, match=r"2 leaf links .l3, finger.*tip="):
        load_arm(urdf(**FINGER))


@pytest.mark.slow
def test_a_xacro_file_is_expanded_where_xacrodoc_is_installed(urdf, tmp_path):
    pytest.importorskip("xacrodoc")
    space = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
    text = urdf().read_text()
    head, _, tail = text.partition(">")
    xacro = tmp_path / "arm.urdf.xacro"
    body = tail.replace('velocity="3"', 'velocity="${speed / 2}"')
    xacro.write_text(f'{head} {space}><xacro:property name="speed" value="5"/>{body}')
    arm = load_arm(xacro)
    assert arm.notes[0] == "The xacro file was expanded by xacrodoc."
    np.testing.assert_array_equal(arm.limits.velocity, [2.5, 2.5, 2.5])
    xacro.write_text(f'{head} {space}><xacro:include filename="none.xacro"/>{body}')
    with pytest.raises(ConfigurationError, match=r"xacrodoc cannot expand arm\.urdf\.xacro: .*none"):
        load_arm(xacro)


@pytest.mark.slow
def test_a_xacro_file_that_does_not_end_is_given_up(tmp_path, monkeypatch):
    pytest.importorskip("xacrodoc")
    monkeypatch.setattr("armctl.robot_description.xacro_file.TIME_LIMIT", 1e-3)
    (tmp_path / "arm.xacro").write_text('<robot name="x"/>')
    with pytest.raises(ConfigurationError, match="did not expand"):
        load_arm(tmp_path / "arm.xacro")

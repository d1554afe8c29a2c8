"""What armctl repairs, leaves out or assumes about a robot's file is told: on load, in results, in their identity."""

import warnings

import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.robot_description import BUILTIN_ARMS, load_arm

from .small_arm import BOX, chain_of, everywhere, link

Z, Y, X = "0 0 1", "0 1 0", "1 0 0"


def noted(path, **options):
    """All notes about a robot, as one text."""
    return "\n".join(load_arm(path, **options).notes)


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


@pytest.mark.parametrize(("excess", "outcome"), [(0, ""), (1e-9, "raised"), (9e-7, "raised"), (0.009, "raised")])
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
        load_arm(urdf(l1=link("l1", BOX, moment=0.021)))

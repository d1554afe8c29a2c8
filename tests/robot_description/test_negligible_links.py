"""Frames and base links without an inertia are common in files of others, and no reason to refuse an arm."""

import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.robot_description import load_arm

from .small_arm import BOX, CYLINDER, everywhere, joint, link

ROUNDED = '<inertia ixx="-3e-25" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'
INERTIAS = {"none": "", "zero": ROUNDED.replace("-3e-25", "0"), "round-off": ROUNDED}


def with_inertia(text, inertia):
    before, _, after = text.partition("<inertia ")
    return before + inertia + after.partition("/>")[2]


def frame(mass, inertia, parent):
    dummy = with_inertia(link("dummy", BOX, mass=mass), inertia)
    return {"dummy": dummy, "to_dummy": joint("to_dummy", parent, "dummy", "fixed", limit="")}


@pytest.mark.one_case
@pytest.mark.parametrize("inertia", INERTIAS.values(), ids=INERTIAS)
def test_frames_and_bases_without_inertia_are_taken_to_have_no_mass(urdf, inertia):
    for parts, name in (
        ({"base": with_inertia(link("base", CYLINDER, mass=5), inertia)}, "base"),
        ({"base": link("base", CYLINDER, moment=1)}, "base"),
        (frame(5, inertia, "base"), "dummy"),
        (frame(1e-4, inertia, "l2"), "dummy"),
    ):
        description, model, world = everywhere(urdf(**parts), tip="l3")
        assert f"Link {name!r} has no inertia that a body can have" in "".join(description.notes)
        np.testing.assert_allclose(model.position(np.zeros(3)), [0, 0, 1.2])
        assert world.body("arm/l2").mass == pytest.approx(1)


@pytest.mark.parametrize("inertia", INERTIAS.values(), ids=INERTIAS)
def test_links_that_matter_need_an_inertia(urdf, inertia):
    for parts, name in (
        ({"l2": with_inertia(link("l2", CYLINDER), inertia)}, "l2"),
        ({"l2": with_inertia(link("l2", CYLINDER, mass=1e-4), inertia)}, "l2"),
    ):
        with pytest.raises(ConfigurationError, match=f"'{name}' has (an impossible inertia|a mass, but no)"):
            load_arm(urdf(**parts), tip="l3")

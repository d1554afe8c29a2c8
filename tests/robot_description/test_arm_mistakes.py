"""What is wrong with a URDF, or with an option beside it, is said, and where."""

import contextlib
import signal

import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.robot_description import load_arm

from .small_arm import BOX, FINGER, everywhere, joint, limited, link


def shaped(shape):
    return {"l1": link("l1", shape)}


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


BAD_FILES = {
    "no limits": ({"j2": joint("j2", "l1", "l2", limit="")}, "'j2'.*lower.*upper"),
    "negative velocity": (limited(velocity=-1), "'j2'.*velocity"),
    "limits swapped": (limited(lower=1, upper=-1), "'j2'.*lower"),
    "limit not a number": (limited(lower="nan"), "'j2'.*lower"),
    "limit infinite": (limited(lower="-inf"), "j2"),
    "limit a word": (limited(lower="low"), "j2"),
    "sliding without limits": ({"j2": joint("j2", "l1", "l2", "prismatic", limit="")}, "'j2'.*lower.*upper"),
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
    "no mass behind a joint": ({"l2": link("l2", BOX, mass=0)}, "'l2' behind.*no mass.*density"),
    "inertia of no body": ({"l2": link("l2", BOX, moment=1)}, "l2"),
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
    "velocity zero": ({"max_velocity": 0}, "velocity.*above 0"),
    "efforts of other joints": ({"max_effort": (1, 2)}, "effort.*, or 3 of them"),
    "density of each link": ({"density": (1000, 2000)}, "density.*one finite number"),
    "density below zero": ({"density": -1}, "density.*above 0"),
    "misspelt": ({"max_speed": 1}, "max_speed.*max_velocity"),
}


@pytest.mark.parametrize(("options", "culprit"), BAD_OPTIONS.values(), ids=BAD_OPTIONS)
def test_what_is_wrong_with_an_option_is_named(urdf, options, culprit):
    with pytest.raises(ConfigurationError, match=culprit):
        load_arm(urdf(), **options)


@pytest.mark.parametrize("home", [[], [0] * 5, [0, 0, 4, 0, 0, 0]])
def test_home_of_a_builtin_arm_is_checked_too(home):
    with pytest.raises(ConfigurationError, match="home"):
        load_arm("ur5", home=home)

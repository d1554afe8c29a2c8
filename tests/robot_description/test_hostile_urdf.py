"""A URDF is data from a stranger: what is malformed, too large or reaches out of its package is refused in words."""

import itertools
import os
import subprocess
import sys

import pytest

from armctl.core.errors import ConfigurationError
from armctl.robot_description import load_arm, urdf, xml_file

from .one_joint_arm import INERTIA, arm


def fixed(parent, name):
    ends = f'<parent link="{parent}"/><child link="{name}"/>'
    return f'<link name="{name}"/><joint name="{name}" type="fixed">{ends}</joint>'


def chain(links):
    """An arm, and behind it that many fixed links."""
    names = ["upper", *(f"l{i}" for i in range(links))]
    return arm(more="".join(fixed(parent, name) for parent, name in itertools.pairwise(names)))


def test_the_small_arm_is_fine(write):
    origin = '<origin xyz="0 0 1" rpy="0 0 0"/>'
    assert load_arm(write(arm(origin=origin, placed=origin, axis='<axis xyz="0 0 2"/>'))).dof == 1


MALFORMED = {
    "no ixy": ({"inertia": INERTIA.replace('ixy="0" ', "")}, "'upper'.* no ixy"),
    "no inertia": ({"inertia": ""}, "'upper'.* no ixx and no ixy"),
    "inertia in words": ({"inertia": INERTIA.replace('"0.01"', '"much"', 1)}, "'upper'.*'much'"),
    "mass in words": ({"mass": "much"}, "mass of link 'upper'.*'much'"),
    "mass below zero": ({"mass": "-1"}, "'upper' has a mass of -1"),
    "mass infinite": ({"mass": "1e999"}, "'upper'.*'1e999'"),
    "inertia placed in letters": ({"placed": '<origin xyz="a b c"/>'}, "inertia of link 'upper'.*'a'"),
    "origin in letters": ({"origin": '<origin xyz="a b c"/>'}, "origin of joint 'shoulder'.*'a'"),
    "origin of two numbers": ({"origin": '<origin xyz="1 2"/>'}, "origin of joint 'shoulder'.*3 numbers.*'1 2'"),
    "origin not a number": ({"origin": '<origin xyz="0 0 nan"/>'}, "origin of joint 'shoulder'.*'nan'"),
    "origin infinite": ({"origin": '<origin rpy="0 -inf 0"/>'}, "origin of joint 'shoulder'.*'-inf'"),
    "origin beyond any": ({"origin": '<origin xyz="0 0 1e300"/>'}, "origin of joint 'shoulder'.*'1e300'"),
    "axis of no length": ({"axis": '<axis xyz="0 0 1e-200"/>'}, "'shoulder' has an axis of length"),
    "very long number": ({"mass": "x" * 100_000}, r"mass of link 'upper': 'xxx.{,60} is not"),
    "ring beside a root": (
        {
            "more": '<link name="x"/><link name="y"/>'
            '<joint name="a" type="fixed"><parent link="x"/><child link="y"/></joint>'
            '<joint name="b" type="fixed"><parent link="y"/><child link="x"/></joint>'
        },
        "tree",
    ),
    "sphere without size": ({"shape": '<sphere radius="1e-300"/>'}, "'upper' has a size of 1e-300"),
    "a world on a joint": ({"more": fixed("upper", "world")}, "'world'"),
    "the floor": ({"more": fixed("upper", "(floor)")}, "'.floor.'"),
    "deep": ({"more": "<a>" * 100_000 + "</a>" * 100_000}, "elements within each other"),
    "many shapes": (
        {"shape": '<sphere radius="1"/></geometry></collision>' + "<collision/>" * 1_000 + "<collision><geometry>"},
        "1002 collision shapes; at most 1000",
    ),
}


@pytest.mark.parametrize(("parts", "culprit"), MALFORMED.values(), ids=MALFORMED)
def test_a_malformed_part_is_named(write, parts, culprit):
    with pytest.raises(ConfigurationError, match=culprit):
        load_arm(write(arm(**parts)))


def test_as_many_links_as_a_file_may_have_are_read_and_more_are_refused(write):
    assert load_arm(write(chain(urdf.MAX_LINKS - 2))).dof == 1
    with pytest.raises(ConfigurationError, match="302 links; at most 300"):
        load_arm(write(chain(urdf.MAX_LINKS)))


@pytest.mark.slow
def test_a_long_chain_ends_in_words_not_in_a_crash(write):
    path = write(chain(5_000))
    done = subprocess.run(
        [sys.executable, "-c", f"import armctl; armctl.load_arm({str(path)!r})"], capture_output=True, text=True
    )
    assert done.returncode == 1, done.returncode
    assert "ConfigurationError: arm.urdf is not an arm that armctl can use: it has 5002 links" in done.stderr


def test_a_large_file_is_refused(write):
    with pytest.raises(ConfigurationError, match="bytes, more than"):
        load_arm(write(arm(more=f"<!--{'x' * xml_file.MAX_BYTES}-->")))


@pytest.mark.parametrize(
    "doctype",
    [
        '<!DOCTYPE robot [<!ENTITY secret SYSTEM "file:///etc/hostname">]>',
        '<!DOCTYPE robot SYSTEM "http://127.0.0.1/robot.dtd">',
        '<!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>',
    ],
)
def test_entities_are_refused(write, doctype):
    with pytest.raises(ConfigurationError, match="document type"):
        load_arm(write(doctype + arm()))


@pytest.mark.parametrize("name", ["\0.urdf", "a" * 300 + ".urdf", "loop/arm.urdf", "."])
def test_a_name_that_is_no_file_is_refused(tmp_path, name, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loop").symlink_to("loop")
    for options in ({"robot": name}, {"robot": "ur5", "srdf": name}):
        with pytest.raises(ConfigurationError, match="there is no robot"):
            load_arm(**options)


def test_a_pipe_as_a_robot_does_not_hang(tmp_path):
    os.mkfifo(tmp_path / "arm.urdf")
    with pytest.raises(ConfigurationError, match="not a regular file"):
        xml_file.read_xml(tmp_path / "arm.urdf")

import itertools

import mujoco
import numpy as np
import pytest

from armctl.envs import make_worlds
from armctl.simulation.scenery import MAX_POINTS, STATE, Scenery, polyline

UNSEEN = 3
"""The first group of geoms that viewers do not show."""


def shown(model, data):
    """Boxes around all geoms that a viewer shows, by what they are: lowest and highest corners, sorted."""
    ids = np.flatnonzero(model.geom_group < UNSEEN)
    return [span(model.geom_aabb[i], data.geom_xpos[i], data.geom_xmat[i]) for i in ids]


def span(box, position, turn):
    """Lowest and highest z, and the horizontal centre, of a box in a frame."""
    turn = np.reshape(turn, (3, 3))
    centre, half = position + turn @ box[:3], np.abs(turn) @ box[3:]
    return (*centre[:2].round(3), *(centre[2] - half[2], centre[2] + half[2]))


def drawn(geoms):
    """The same of decoration; parts at one place, as meshes are drawn in, are one."""
    spans = {}
    for geom in geoms:
        if geom.category == mujoco.mjtCatBit.mjCAT_DECOR and geom.type != mujoco.mjtGeom.mjGEOM_BOX:
            continue
        size = np.array(geom.size)  # of MjvGeom: half sizes along the axes, whatever the shape
        x, y, low, high = span(np.r_[0, 0, 0, size], np.array(geom.pos, float), np.array(geom.mat, float))
        before = spans.get((x, y), (low, high))
        spans[x, y] = (min(low, before[0]), max(high, before[1]))
    return [(*place, *heights) for place, heights in spans.items()]


def above_ground(spans):
    """In order, without what an episode has no use for, which is hidden far below."""
    return np.array(sorted(one for one in spans if one[3] > -5))


@pytest.mark.parametrize("env", ["armctl/ArmReach-v0", "armctl/ArmReachObstacles-v0", "armctl/BridgeCross-v0"])
def test_a_copy_of_the_model_and_what_is_missing_show_the_world_as_it_is(env):
    worlds = make_worlds(env, 1)
    worlds.reset(seed=[0])
    simulation = worlds.task.simulation
    scenery = Scenery(simulation, worlds.task.camera)
    places = []
    for episode in (3, 4):
        worlds.reset(seed=[0], options={"episode": [episode]})
        for _ in range(3):
            worlds.step(np.zeros(worlds.action_space.shape))
        state, geoms = scenery.snapshot()
        viewed = mujoco.MjData(scenery.model)
        mujoco.mj_setState(scenery.model, viewed, state, STATE)
        mujoco.mj_forward(scenery.model, viewed)
        seen = above_ground([*shown(scenery.model, viewed), *drawn(geoms)])
        places.append(above_ground(shown(simulation.model, simulation.data(0))))
        np.testing.assert_allclose(seen, places[-1], atol=2e-3)
        assert all(geom.type != mujoco.mjtGeom.mjGEOM_MESH for geom in geoms)  # browsers cannot decorate with one
    assert places[0].shape != places[1].shape or not np.allclose(*places)


def test_contacts_are_decorated_and_the_physics_is_left_alone():
    worlds = make_worlds("armctl/BridgeCross-v0", 1)
    worlds.reset(seed=[0])
    simulation = worlds.task.simulation
    before = simulation.model.geom_group.copy()
    scenery = Scenery(simulation, worlds.task.camera)
    worlds.step([[1.0, 0.0]])
    decorations = [geom for geom in scenery.snapshot()[1] if geom.category == mujoco.mjtCatBit.mjCAT_DECOR]
    assert len(decorations) >= 4  # each wheel stands on the deck
    np.testing.assert_array_equal(simulation.model.geom_group, before)
    assert (scenery.model.geom_group != before).any()


def test_the_camera_starts_where_the_mjcf_has_it():
    worlds = make_worlds("armctl/ArmReach-v0", 1)
    worlds.reset(seed=[0])
    scenery = Scenery(worlds.task.simulation, worlds.task.camera)
    camera, scene = mujoco.MjvCamera(), mujoco.MjvScene(scenery.model, maxgeom=100)
    mujoco.mjv_defaultFreeCamera(scenery.model, camera)
    data = mujoco.MjData(scenery.model)
    mujoco.mj_forward(scenery.model, data)
    mujoco.mjv_updateScene(scenery.model, data, mujoco.MjvOption(), None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
    eyes = (np.array(scene.camera[0].pos) + np.array(scene.camera[1].pos)) / 2
    np.testing.assert_allclose(eyes, data.camera("overview").xpos, atol=1e-3)


def test_a_line_leads_along_its_points_and_a_long_one_is_thinned_out():
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 2, 0]], dtype=float)
    line = polyline(points, 0.01, (1, 0, 0, 1), beads=True)
    capsules = [geom for geom in line if geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE]
    beads = [geom.pos for geom in line if geom.type == mujoco.mjtGeom.mjGEOM_SPHERE]
    np.testing.assert_allclose([geom.pos for geom in capsules], [(a + b) / 2 for a, b in itertools.pairwise(points)])
    np.testing.assert_allclose([2 * geom.size[2] for geom in capsules], [1, 2], atol=1e-6)
    np.testing.assert_allclose(beads, points)
    assert len(polyline(np.random.default_rng(0).uniform(size=(1000, 3)), 0.01, (1, 0, 0, 1))) == MAX_POINTS - 1
    assert polyline(np.zeros((0, 3)), 0.01, (1, 0, 0, 1)) == []

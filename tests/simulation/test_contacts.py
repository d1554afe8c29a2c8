import mujoco
import numpy as np
import pytest

from armctl.robots.rover import PARTS, PREFIX
from armctl.simulation import ContactSensors, Simulation
from armctl.tasks.bridge.options import WALKER_RADIUS
from armctl.tasks.bridge.world import BLOCK_SIZES, CONTACT_CLASSES, build_bridge_world

OUTWARD = {
    "base": (1, 0, 0),
    "front_left_wheel": (0.35, 1, -0.6),
    "front_right_wheel": (0.35, -1, -0.6),
    "rear_left_wheel": (-0.35, 1, -0.6),
    "rear_right_wheel": (-0.35, -1, -0.6),
}
"""A direction in the rover's frame in which each part is the outermost."""
SURFACES = {
    "floor": ((7.0, 0.0, 0.0), (0, 0, 1)),
    "deck": ((10.0, 2.0, -0.3), (0, 1, 0)),
    "barrier": ((5.0 - BLOCK_SIZES[0][0], 0.0, 0.5), (-1, 0, 0)),
    "obstacle": ((13.0, -WALKER_RADIUS, 0.8), (0, -1, 0)),
    "goal": ((19.0, 0.0, 0.001), (0, 0, 1)),
    "ground": ((10.0, 20.0, -4.0), (0, 0, 1)),
}
"""A point on a thing of each class, and the normal there."""
GAP, SPEED = 0.001, 0.5


@pytest.fixture(scope="module")
def bridge():
    return build_bridge_world(20.0, 4.0, 1, (WALKER_RADIUS,), 0.002, 4, (8, 8), 90.0)


def aim(model, part, surface):
    """Pose in which `part` is nearest to the surface, `GAP` away from it, and the velocity into it."""
    point, normal = np.array(surface[0]), np.array(surface[1], dtype=float)
    outward = np.array(OUTWARD[part], dtype=float)
    outward /= np.linalg.norm(outward)
    rotation = align(outward, -normal)
    outermost = {name: furthest_point(model, name, outward) for name in PARTS}
    reach = outermost[part] @ outward
    assert all(reach > point @ outward + 0.01 for name, point in outermost.items() if name != part)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, rotation.ravel())
    return point + normal * GAP - rotation @ outermost[part], quaternion, -SPEED * normal


def furthest_point(model, part, direction):
    """The point of a box or a wheel that is furthest in a direction, all in the rover's frame."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    geom = next(i for i in range(model.ngeom) if model.geom(i).name == PREFIX + part)
    rotation, size = data.geom_xmat[geom].reshape(3, 3), model.geom_size[geom]
    along = np.where(np.abs(rotation.T @ direction) < 1e-9, 0.0, rotation.T @ direction)
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_BOX:
        corner = np.sign(along) * size
    else:
        rim = along[:2] / max(np.linalg.norm(along[:2]), 1e-9)
        corner = np.array([*(size[0] * rim), size[1] * np.sign(along[2])])
    return data.geom_xpos[geom] - data.body(PREFIX + "base").xpos + rotation @ corner


def align(a, b):
    """Rotation that takes unit vector `a` to `b`."""
    cross, cosine = np.cross(a, b), a @ b
    if np.linalg.norm(cross) < 1e-9:
        if cosine > 0:
            return np.eye(3)
        cross = np.cross(a, [0.3, 0.5, 0.8])
        cross /= np.linalg.norm(cross)
        return 2 * np.outer(cross, cross) - np.eye(3)
    skew = np.array([[0, -cross[2], cross[1]], [cross[2], 0, -cross[0]], [-cross[1], cross[0], 0]])
    return np.eye(3) + skew + skew @ skew / (1 + cosine)


@pytest.mark.parametrize("label", CONTACT_CLASSES)
@pytest.mark.parametrize("part", PARTS)
def test_each_part_reports_just_the_class_that_it_is_driven_into(bridge, part, label):
    simulation = Simulation(bridge, 3)
    sensors = ContactSensors(simulation, PARTS, CONTACT_CLASSES)
    places = simulation.per_world("body_pos")
    places[:, bridge.body("block_0").id] = (5.0, 0.0, 0.0)
    places[:, bridge.body("walker_0").id] = (13.0, 0.0, 0.0)
    simulation.reset()
    position, quaternion, velocity = aim(bridge, part, SURFACES[label])
    driven = 1  # the worlds beside it stand at the start, and feel nothing of it
    simulation.array("qpos")[driven, :7] = [*position, *quaternion]
    simulation.array("qvel")[driven, :3] = velocity
    simulation.refresh()
    assert not sensors.current()[driven].any()
    for _ in range(5):
        simulation.step(1)
        if sensors.current()[driven].any():
            break
    expected = np.zeros((len(PARTS), len(CONTACT_CLASSES)), dtype=bool)
    expected[PARTS.index(part), list(CONTACT_CLASSES).index(label)] = True
    np.testing.assert_array_equal(sensors.current()[driven], expected)
    standing = np.zeros_like(expected)
    standing[1:, list(CONTACT_CLASSES).index("floor")] = True
    for world in (0, 2):
        np.testing.assert_array_equal(sensors.current()[world], standing)


def test_a_touch_between_two_readings_is_remembered_and_then_forgotten(bridge):
    simulation = Simulation(bridge, 1)
    sensors = ContactSensors(simulation, PARTS, CONTACT_CLASSES)
    goal = list(CONTACT_CLASSES).index("goal")
    simulation.reset()
    simulation.array("qpos")[0, :3] += (18.0, 0.0, 0.0)  # the wheels stand beside the line, on both sides
    simulation.array("qpos")[0, 2] += 0.05
    simulation.refresh()
    data = simulation.array("qpos")
    touched = []
    for k in range(60):
        data[0, 2] = 0.3 if k % 10 else 0.093  # on the ground for one step of ten
        simulation.array("qvel")[:] = 0.0
        simulation.step(4)
        touched.append(sensors.since_last_step()[0, 1:].any())
        assert not sensors.current().any() or data[0, 2] < 0.1
    assert all(touched[::10])
    assert not any(touched[1::10])
    assert not sensors.since_last_step()[0, 0, goal]


def test_a_reset_forgets_touches(bridge):
    simulation = Simulation(bridge, 2)
    sensors = ContactSensors(simulation, PARTS, CONTACT_CLASSES)
    simulation.reset()
    simulation.refresh()
    fresh = sensors.since_last_step().copy()
    simulation.array("qpos")[:, 2] = 0.093
    simulation.array("qpos")[:, 0] = 19.0
    simulation.step(4)
    simulation.reset(np.array([0], dtype=np.int32))
    simulation.refresh(np.array([0], dtype=np.int32))
    np.testing.assert_array_equal(sensors.since_last_step()[0], fresh[0])

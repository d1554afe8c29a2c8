import mujoco
import numpy as np
import pytest

from armctl.robots.rover import CAMERA, GEOM_GROUP
from armctl.simulation import RayCamera, Simulation
from armctl.simulation.ray_camera import pixel_rays, vertical_field_of_view
from armctl.tasks.bridge.observation import PIXEL_CLASSES, pixel_classes
from armctl.tasks.bridge.world import LOOKS, build_bridge_world

RESOLUTION, FIELD_OF_VIEW = (48, 32), 90.0


@pytest.fixture(scope="module")
def bridge():
    return build_bridge_world(20.0, 4.0, 3, (0.25, 0.25), 0.005, 4, RESOLUTION, FIELD_OF_VIEW)


def furnished(model, n):
    """Worlds with blocks and walkers in other places, and the rover turned a little; and its camera."""
    simulation = Simulation(model, n)
    camera = RayCamera(simulation, CAMERA, RESOLUTION, FIELD_OF_VIEW, (GEOM_GROUP, LOOKS))
    places, rng = simulation.per_world("body_pos"), np.random.default_rng(0)
    for name in ("block_0", "block_1", "block_2", "walker_0", "walker_1"):
        places[:, model.body(name).id] = rng.uniform((2, -1.3, 0), (8, 1.3, 0), (n, 3))
    simulation.reset()
    yaw = rng.uniform(-1, 1, n)
    simulation.array("qpos")[:, 3] = np.cos(yaw / 2)
    simulation.array("qpos")[:, 6] = np.sin(yaw / 2)
    simulation.refresh()
    return simulation, camera


def renderer_of(model):
    width, height = RESOLUTION
    renderer = mujoco.Renderer(model, height, width)
    options = mujoco.MjvOption()
    options.geomgroup[[GEOM_GROUP, LOOKS]] = 0
    return renderer, options


@pytest.mark.opengl
def test_depth_and_class_are_those_of_the_renderer(bridge):
    renderer, options = renderer_of(bridge)
    simulation, camera = furnished(bridge, 8)
    depth = camera.depth(10.0)
    classes = camera.classes(pixel_classes(bridge), PIXEL_CLASSES.index("sky"))
    assert depth.shape == classes.shape == (8, 32, 48)
    for world in range(8):
        data = simulation.data(world)
        renderer.enable_depth_rendering()
        renderer.update_scene(data, CAMERA, options)
        drawn = np.minimum(renderer.render(), 10.0)
        renderer.disable_depth_rendering()
        close = np.abs(drawn - depth[world]) < 0.02 + 0.02 * drawn
        assert close.mean() > 0.97  # but for the outlines
        renderer.enable_segmentation_rendering()
        renderer.update_scene(data, CAMERA, options)
        geoms = renderer.render()[..., 0]
        renderer.disable_segmentation_rendering()
        drawn_classes = np.where(geoms < 0, 0, pixel_classes(bridge)[geoms])
        assert (drawn_classes == classes[world]).mean() > 0.97


def test_some_worlds_are_seen_as_all_are(bridge):
    _, camera = furnished(bridge, 6)
    some = np.array([1, 4], dtype=np.int32)
    np.testing.assert_array_equal(camera.depth(10.0, some), camera.depth(10.0)[some])
    everything = camera.classes(pixel_classes(bridge), 0)
    np.testing.assert_array_equal(camera.classes(pixel_classes(bridge), 0, some), everything[some])
    assert len(np.unique(camera.depth(10.0).reshape(6, -1), axis=0)) == 6


def test_depth_is_along_the_optical_axis(bridge):
    simulation, camera = furnished(bridge, 1)
    places = simulation.per_world("body_pos")
    for name in ("block_0", "block_1", "walker_0", "walker_1"):
        places[0, bridge.body(name).id] = (0.0, 0.0, -50.0)
    places[0, bridge.body("block_2").id] = (2.3, 0.0, 0.0)
    simulation.reset()
    simulation.refresh()
    depth = camera.depth(10.0)[0]
    front = simulation.data(0).camera(CAMERA)
    ahead = -front.xmat.reshape(3, 3)[:, 2]
    face = 2.3 - bridge.geom_size[bridge.body("block_2").geomadr[0], 0]
    middle = depth[15:17, 23:25].mean()
    assert front.xpos[0] + middle * ahead[0] == pytest.approx(face, abs=0.02)
    assert depth.max() == 10.0


@pytest.mark.parametrize(("resolution", "field_of_view"), [((48, 32), 90.0), ((7, 5), 40.0), ((64, 64), 120.0)])
def test_rays_span_the_field_of_view(resolution, field_of_view):
    rays = pixel_rays(resolution, field_of_view)
    assert rays.shape == (resolution[1], resolution[0], 3)
    step = rays[0, 1, 0] - rays[0, 0, 0]
    edge = rays[0, -1, 0] + step / 2
    assert 2 * np.degrees(np.arctan(edge)) == pytest.approx(field_of_view)
    top = rays[0, 0, 1] + step / 2
    assert 2 * np.degrees(np.arctan(top)) == pytest.approx(vertical_field_of_view(resolution, field_of_view))
    np.testing.assert_allclose(rays[::-1, :, 1], -rays[..., 1], atol=1e-12)


def test_every_convex_shape_is_hit_where_mujocos_rays_hit_it():
    rng, spec = np.random.default_rng(0), mujoco.MjSpec()
    spec.add_mesh(name="rock", uservert=rng.normal(size=(20, 3)).ravel())
    kinds = mujoco.mjtGeom
    sizes = {
        kinds.mjGEOM_SPHERE: [0.3, 0, 0], kinds.mjGEOM_CAPSULE: [0.2, 0.4, 0], kinds.mjGEOM_CYLINDER: [0.3, 0.4, 0],
        kinds.mjGEOM_BOX: [0.3, 0.2, 0.4], kinds.mjGEOM_PLANE: [0.7, 0, 0.1], kinds.mjGEOM_MESH: [0, 0, 0],
    }  # fmt: skip
    for kind, size in sizes.items():
        for _ in range(4):
            body = spec.worldbody.add_body(pos=rng.uniform(-2, 2, 3), quat=rng.normal(size=4))
            mesh = {"meshname": "rock"} if kind == kinds.mjGEOM_MESH else {}
            body.add_geom(type=kind, size=size, **mesh)
    spec.worldbody.add_geom(type=kinds.mjGEOM_SPHERE, size=[0.9, 0, 0], rgba=[1, 1, 1, 0])  # unseen
    eye = spec.worldbody.add_body(name="eye", mocap=True)
    eye.add_camera(name="eye")
    simulation = Simulation(spec.compile(), 60)
    camera = RayCamera(simulation, "eye", (40, 30), 100.0, ())
    simulation.array("mocap_pos")[:, 0] = rng.uniform(-2.5, 2.5, (60, 3))
    turns = rng.normal(size=(60, 4))
    simulation.array("mocap_quat")[:, 0] = turns / np.linalg.norm(turns, axis=1, keepdims=True)
    simulation.refresh()
    depths, geoms = camera._cast(None)
    expected, hit = camera._cast_by_mujoco(np.arange(60, dtype=np.int32), depths.shape)
    assert set(np.unique(hit)) == {-1, *range(1, 25)}, "all but the unseen one, 0"
    same = geoms == hit
    assert same.mean() > 0.999, "rays that graze an edge may differ"
    both = same & (hit >= 0)
    np.testing.assert_allclose(depths[both], expected[both], atol=1e-3 / 10)
    some = np.array([7, 3], dtype=np.int32)
    np.testing.assert_array_equal(camera._cast(some)[0], depths[some])


def test_a_scene_with_other_shapes_is_seen_by_mujocos_rays():
    spec = mujoco.MjSpec()
    spec.add_mesh(
        name="hollow",
        uservert=np.ravel([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0.1, 0.1, 0.1)]),
        userface=np.ravel([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 4, 3), (4, 2, 3), (1, 2, 4)]),
    )
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="hollow")
    spec.worldbody.add_camera(name="eye", pos=[0.2, 0.2, 3])
    simulation = Simulation(spec.compile(), 2)
    camera = RayCamera(simulation, "eye", (20, 20), 60.0, ())
    simulation.refresh()
    assert camera._shapes is None
    assert np.isfinite(camera.depth(10.0)).all()

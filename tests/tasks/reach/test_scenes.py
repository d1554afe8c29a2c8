import dataclasses
import io
import tarfile
from pathlib import Path

import make_motion_bench_maker
import mujoco
import numpy as np
import pytest
import yaml

import armctl
from armctl.baselines.reach_task import POSE_CLEARANCES, POSE_SEARCH
from armctl.core.errors import ArmctlError, ConfigurationError
from armctl.core.shipped import write_shipped
from armctl.envs import TaskVectorEnv, make_worlds
from armctl.kinematics import ArmModel, MinimumTimePose
from armctl.planning import ArmPlanner, ArmPlannerOptions, PathCertificate
from armctl.tasks import ReachOutcome, ReachScenesTask
from armctl.tasks.reach import read_boxes
from armctl.tasks.reach.motion_bench_maker import FORMAT, MAX_BOXES, ROBOTS, SCENES, problems_file, shipped_problems

from ...capsule_world import CapsuleWorld

ENV = "armctl/ArmScenes-v0"
UR5, PANDA = ROBOTS
SHIPPED = shipped_problems(UR5)
SEED = 3


@pytest.fixture(scope="module")
def model():
    return ArmModel(UR5)


def worlds(n, **options):
    return TaskVectorEnv(n, task=ReachScenesTask, **options)


def row_of(scene, number, problems=SHIPPED):
    return int(np.flatnonzero((problems.scenes == SCENES.index(scene)) & (problems.numbers == number))[0])


def boxes_of(row, problems=SHIPPED):
    return read_boxes(problems.boxes[row], problems.boxes.shape[-1])


# The problems


@pytest.mark.parametrize("robot", ROBOTS)
def test_there_are_a_hundred_problems_of_each_scene(robot):
    problems = shipped_problems(robot)
    assert np.array_equal(np.bincount(problems.scenes), [100] * len(SCENES))
    for scene in range(len(SCENES)):
        assert np.array_equal(problems.numbers[problems.scenes == scene], np.arange(1, 101))
    assert problems.counts.max() == MAX_BOXES
    assert (problems.packed[:, 2] > 0).all()  # the floor is armctl's


@pytest.mark.parametrize(("robot", "arm", "count"), [(UR5, "ur5", 3), (PANDA, "panda", 1)])
def test_problems_are_those_of_their_files(tmp_path, robot, arm, count):
    documents = yaml.safe_load(Path(__file__).with_name("motion_bench_maker.yaml").read_text())
    with tarfile.open(tmp_path / "problems.tar.bz2", "w:bz2") as archive:
        for name, document in documents.items():
            if f"_{arm}/" in name:
                member, content = tarfile.TarInfo(name), yaml.safe_dump(document).encode()
                member.size = len(content)
                archive.addfile(member, io.BytesIO(content))
    model, shipped, raised = ArmModel(robot), shipped_problems(robot), make_motion_bench_maker.RAISED[robot]
    problems = make_motion_bench_maker.read_archive(tmp_path / "problems.tar.bz2", model.description.joints, raised)
    assert len(problems) == count
    for (scene, number), (start, goal, boxes) in problems.items():
        row, name = row_of(SCENES[scene], number, shipped), f"problems/{SCENES[scene]}_{arm}/"
        np.testing.assert_array_equal((shipped.starts[row], shipped.goals[row]), (start, goal))
        np.testing.assert_array_equal(shipped.boxes[row, : len(boxes)], boxes)
        assert shipped.counts[row] == len(boxes)
        objects = documents[f"{name}scene{number:04d}.yaml"]["world"]["collision_objects"]
        assert len(objects) == len(boxes)
        request = documents[f"{name}request{number:04d}.yaml"]
        for joint in request["goal_constraints"][0]["joint_constraints"]:
            place = model.description.joints.index(joint["joint_name"])
            assert goal[place] == pytest.approx(joint["position"], abs=1e-6)
        np.testing.assert_allclose(start, request["start_state"]["joint_state"]["position"][: model.dof], atol=1e-6)


def test_a_box_is_what_its_file_says_and_a_can_has_its_volume():
    """The lid of the box is tilted by 45 degrees; positions on the table are relative to an object's own pose."""
    documents = yaml.safe_load(Path(__file__).with_name("motion_bench_maker.yaml").read_text())
    for name, tilted in (("box_ur5/scene0001", ["side_cap"]), ("table_pick_ur5/scene0007", [])):
        objects = documents[f"problems/{name}.yaml"]["world"]["collision_objects"]
        rows = make_motion_bench_maker.boxes_of(documents[f"problems/{name}.yaml"])
        for thing, row in zip(objects, rows, strict=True):
            sizes, kind = thing["primitives"][0]["dimensions"], thing["primitives"][0]["type"]
            volume = np.pi * sizes[1] ** 2 * sizes[0] if kind == "cylinder" else np.prod(sizes)
            assert np.prod(2 * row[3:6]) == pytest.approx(volume, rel=1e-5)
            assert row[7] == pytest.approx(np.pi / 4 if thing["id"] in tilted else 0.0, abs=1e-3)
            if "pose" not in thing:
                np.testing.assert_allclose(row[:3], thing["primitive_poses"][0]["position"], atol=1e-6)


@pytest.mark.parametrize(
    "change",
    [{"type": "sphere", "dimensions": [0.1]}, {"type": "box", "dimensions": [0.1, 0.1, 0.1]}],
)
def test_a_scene_that_boxes_cannot_be_is_refused(change):
    turned = {"position": [0, 0, 0], "orientation": [0.5, 0, 0, 0.8660254]}
    thing = {"id": "odd", "primitives": [change], "primitive_poses": [turned]}
    with pytest.raises(ValueError, match=r"odd is a sphere|turned otherwise"):
        make_motion_bench_maker.boxes_of({"world": {"collision_objects": [thing]}})


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_file_is_read_as_it_was_written(tmp_path, robot):
    write_shipped(shipped_problems(robot), FORMAT, tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == problems_file(robot).read_bytes()


def test_problems_that_do_not_fit_together_are_refused():
    for change in (
        {"starts": SHIPPED.starts[:1]}, {"counts": SHIPPED.counts + np.uint8(30)}, {"packed": -SHIPPED.packed},
        {"scenes": SHIPPED.scenes + np.uint8(7)}, {"goals": np.full_like(SHIPPED.goals, np.nan)},
    ):  # fmt: skip
        with pytest.raises(ConfigurationError, match=r"should (be|have)|problems"):
            dataclasses.replace(SHIPPED, **change)


# What is certified


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_feasible_problem_is_free_at_its_start_and_within_the_limits(robot):
    model, problems = ArmModel(robot), shipped_problems(robot)
    for row in np.flatnonzero(problems.feasible)[::5]:
        start, goal = (q[row].astype(float) for q in (problems.starts, problems.goals))
        assert model.within_limits(np.array((start, goal))).all()
        assert model.among(boxes_of(row, problems)).is_free(start)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "scene", "number"),
    [(UR5, "box", 1), (UR5, "cage", 2), (UR5, "table_under_pick", 3), (PANDA, "box", 1), (PANDA, "cage", 5)],
)
def test_certified_and_planned_paths_are_free_in_mujoco_and_end_in_the_pose(robot, scene, number):
    model, problems = ArmModel(robot), shipped_problems(robot)
    search, row = MinimumTimePose(model, 0.02 / np.radians(10)), row_of(scene, number, problems)
    boxes, goal = boxes_of(row, problems), problems.goals[row].astype(float)
    start, target = problems.starts[row].astype(float), search.place(goal)
    free = np.vstack((goal, *search.at_centre(start, target)))
    certified = PathCertificate(model, make_motion_bench_maker.CERTIFICATE).path_to(free, start, boxes)
    choice = ArmPlannerOptions(clearance=POSE_CLEARANCES[-1], **POSE_SEARCH)
    planned = ArmPlanner(model, choice, search).plan(start, target, 0.02, boxes).path
    world = CapsuleWorld(model, boxes)
    for path, radius in ((certified, 1e-4), (planned, 0.02)):
        assert bool(len(path)) == problems.feasible[row]
        if len(path):
            shares = np.linspace(0, 1, 40)[:, None, None]
            points = (path[:-1] + shares * np.diff(path, axis=0)).reshape(-1, model.dof)
            assert min(world.distance(q) for q in points) > 0
            assert np.linalg.norm(search.place(path[-1]) - target) <= radius


# The task


def test_an_episode_is_its_problem(model):
    env = worlds(6, scenes="box,table_under_pick", solvable=False)
    observations, infos = env.reset(seed=SEED)
    for world in range(6):
        row = row_of(*env.task.problem(world))
        q, target, boxes = observations[world, 3:9], observations[world, 9:12], observations[world, 24:]
        np.testing.assert_array_equal(q, SHIPPED.starts[row])
        np.testing.assert_allclose(target, model.position(SHIPPED.goals[row].astype(float)), atol=1e-6)
        np.testing.assert_array_equal(boxes.reshape(MAX_BOXES, -1), SHIPPED.boxes[row])
        assert infos["feasible"][world] == SHIPPED.feasible[row]
        assert len(env.task.boxes(world)) == SHIPPED.counts[row]


def test_all_boxes_are_in_the_simulation_where_they_are_observed():
    env = worlds(2, scenes="box")
    env.reset(seed=SEED)
    simulation = env.task.simulation
    for world in range(2):
        boxes, model = env.task.boxes(world), simulation.model
        for i in range(MAX_BOXES):
            geom, body = model.geom(f"box_{i}").id, model.body(f"box_{i}").id
            position, quaternion = (simulation.field(name)[world, body] for name in ("body_pos", "body_quat"))
            if i >= len(boxes):
                assert position[2] < -5
                continue
            rotation = np.empty(9)
            mujoco.mju_quat2Mat(rotation, quaternion)
            np.testing.assert_allclose(rotation.reshape(3, 3), boxes.rotations[i], atol=1e-9)
            np.testing.assert_allclose(position, boxes.centres[i], atol=1e-9)
            np.testing.assert_allclose(simulation.field("geom_size")[world, geom], boxes.half_sizes[i], atol=1e-9)


def test_an_arm_that_stays_at_its_start_touches_nothing_and_one_at_a_box_has_collided():
    env = worlds(4)
    env.reset(seed=SEED)
    for _ in range(5):
        _, _, terminated, _, infos = env.step(env.task.arm.joint_positions.copy())
        assert not terminated.any()
        assert not any(touched.any() for touched in infos["contacts"].values())
    into_the_scene = np.tile(env.task.certificates.mean(axis=0), (4, 1))
    outcomes = set()
    for _ in range(60):
        env.step(into_the_scene)
        outcomes |= set(env.task.outcome().tolist())
    assert ReachOutcome.COLLIDED in outcomes


def test_resets_are_exact_and_world_i_is_the_single_world_of_seed_plus_i():
    together = worlds(3)
    first = together.reset(seed=SEED)[0]
    moves = first[:, 3:9] + 0.1
    after = [together.step(moves)[0] for _ in range(4)]
    np.testing.assert_array_equal(together.reset(seed=SEED)[0], first)
    for world in range(3):
        alone = worlds(1)
        np.testing.assert_array_equal(alone.reset(seed=SEED + world)[0][0], first[world])
        for observation in after:
            np.testing.assert_array_equal(alone.step(moves[[world]])[0][0], observation[world])


def test_a_seed_goes_through_all_problems_in_an_order_of_its_own():
    env, orders = make_worlds(ENV, 1, {"scenes": "cage", "problems": "test"}), []
    count = int((SHIPPED.feasible & (SHIPPED.scenes == SCENES.index("cage")) & (SHIPPED.numbers > 80)).sum())
    for seed in (1, 2):
        order = []
        for episode in range(count):
            env.reset(seed=seed, options={"episode": episode})
            order.append(env.task.problem(0)[1])
        assert len(set(order)) == count
        assert min(order) > 80
        orders.append(order)
    assert orders[0] != orders[1]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scenes": "bookshelf_smal"}, "'bookshelf_smal'.*bookshelf_small"),
        ({"scenes": "box,"}, "scene ''"),
        ({"scenes": ""}, "scene ''"),
        ({"scenes": 3}, "scenes"),
        ({"problems": "tset"}, "test"),
        ({"home": (0.0,) * 6}, "begins where its problem does"),
        ({"robot": "ur5"}, "ur5_robotiq85 and panda_open, not for 'ur5'"),
        ({"goal": True}, "goal"),
        ({"scene": "box"}, "scenes"),
    ],
)
def test_other_options_are_refused(options, message):
    with pytest.raises(ConfigurationError, match=message):
        worlds(1, **options)


# Who plays


@pytest.mark.slow
@pytest.mark.parametrize(
    ("policy", "robot", "wins"),
    [
        ("reach_ompl", UR5, 6), ("reach_ompl:prepared=false", UR5, 6), ("reach_mpc", UR5, 4),
        ("reach_ompl", PANDA, 6), ("reach_mpc", PANDA, 5),
    ],
)  # fmt: skip
def test_experts_reach_poses_among_boxes(policy, robot, wins):
    options = {"robot": robot}
    assert armctl.evaluate(policy, ENV, episodes=7, seed=SEED, env_options=options).success.sum() >= wins


def test_experts_of_positions_refuse_the_task():
    for policy in ("reach_mppi", "reach_impedance", "obstacles_plan_bc"):
        with pytest.raises(ArmctlError, match=policy):
            armctl.make_policy(policy, make_worlds(ENV, 1))

import gymnasium
import mujoco
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.disturbances import ARM, ROVER, available
from armctl.episodes.record import TIME_COLUMNS
from armctl.kinematics import ArmModel
from armctl.robots.rover import WHEEL_RADIUS, WHEELS
from armctl.rollout import evaluate
from armctl.simulation.worlds import world_path
from tests.disturbances.disturbed import BRIDGE, REACH, check_single_environments, fields, played, worlds

ENVS = (
    REACH,
    "armctl/ArmLift-v0",
    "armctl/ArmPose-v0",
    "armctl/ArmPush-v0",
    "armctl/ArmReachMoving-v0",
    "armctl/ArmReachObstacles-v0",
    "armctl/ArmScenes-v0",
    BRIDGE,
)


@pytest.mark.one_case
@pytest.mark.parametrize("env", ENVS)
def test_at_neutral_levels_an_environment_is_bit_for_bit_what_it_was(env):
    plain = worlds(env, 2)
    neutral = worlds(
        env, 2, {name: kind.neutral for name, kind in available(plain.task.disturbances, plain.task).items()}
    )
    assert all(np.array_equal(a, b) for a, b in zip(played(plain), played(neutral), strict=True))


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("env", "name"),
    [(REACH, name) for name in ARM]
    + [pytest.param(BRIDGE, name, marks=() if name == "delay" else pytest.mark.slow) for name in ROVER],
)
def test_every_world_is_the_single_environment_of_its_seed(env, name):
    check_single_environments(env, {name: (ARM if env == REACH else ROVER)[name].levels[-1]}, decisions=12)


@pytest.mark.parametrize("mode", ["same_step", "next_step"])
def test_an_autoreset_begins_the_disturbances_of_the_next_episode(mode):
    disturbances = {"noise": 0.1, "mismatch": 0.1, "delay": 2}
    env = worlds(n=2, disturbances=disturbances, autoreset_mode=mode, max_episode_steps=3)
    for _ in range(3 if mode == "same_step" else 4):
        after, *_ = env.step(np.ones((2, 6)))
    assert env.episodes.tolist() == [1, 1]
    asked, _ = worlds(n=2, disturbances=disturbances).reset(seed=0, options={"episode": 1})
    assert np.array_equal(after, asked)


def test_all_at_once_are_the_same_with_any_number_of_worlds():
    options = {"disturbances": {name: kind.levels[1] for name, kind in ARM.items()}}
    one, many = (
        evaluate("reach_ik", episodes=6, worlds=n, env_options=options, lower_bound_steps=False) for n in (1, 4)
    )
    left_out = list(TIME_COLUMNS)
    assert one.drop(columns=left_out).equals(many.drop(columns=left_out))


def test_noise_has_its_standard_deviation_and_leaves_the_truth_alone():
    plain, noisy = worlds(n=200), worlds(n=200, disturbances={"noise": 0.03})
    for env in (plain, noisy):
        env.reset(seed=1)
    hold = np.tile(plain.task.arm.description.home, (200, 1))
    for _ in range(3):
        truth, rewards, *_ = plain.step(hold)
        seen, same_rewards, *_ = noisy.step(hold)
    assert np.array_equal(plain.task.state.joint_positions, noisy.task.state.joint_positions)
    assert np.array_equal(rewards, same_rewards)
    noise = (seen - truth)[truth != 0]
    assert abs(noise.std() - 0.03) < 0.03 * 4 / np.sqrt(2 * len(noise))
    assert abs(noise.mean()) < 0.03 * 4 / np.sqrt(len(noise))
    assert seen.dtype == truth.dtype


def test_noise_of_one_decision_is_that_of_no_other_and_stays_while_it_is_looked_at():
    env = worlds(n=2, disturbances={"noise": 0.1})
    first, _ = env.reset(seed=0)
    again, _ = env.reset(seed=0, options={"reset_mask": np.array([True, False])})
    assert np.array_equal(first, again)
    truth = env.task.observe()
    second, *_ = env.step(np.tile(env.task.arm.description.home, (2, 1)))
    assert not np.isclose(first - truth, second - env.task.observe(), atol=1e-6).any()


def test_noise_shows_nothing_where_nothing_is():
    env = worlds("armctl/ArmReachObstacles-v0", 1, {"noise": 0.05})
    absent = env.task.observe()[0] == 0
    assert absent.sum() > 7
    assert (env.reset(seed=0)[0][0][env.task.observe()[0] == 0] == 0).all()


def test_noisy_depth_stays_in_its_range():
    env = worlds(BRIDGE, disturbances={"noise": 2.0})
    seen, _ = env.reset(seed=0)
    assert env.observation_space.contains(seen)
    truth = env.task.observe()["image"]
    assert np.abs(seen["image"] - truth).max() > 1.0


@pytest.mark.parametrize("control", ["position", "delta", "velocity", "torque"])
def test_late_actions_are_the_earlier_ones_and_before_them_the_arm_stands(control):
    plain, late = worlds(control=control), worlds(control=control, disturbances={"delay": 3})
    stand = np.zeros((1, 6)) if control != "position" else plain.task.arm.description.home[None]
    for env in (plain, late):
        env.reset(seed=0)
    actions = 0.5 * np.random.default_rng(0).uniform(plain.action_space.low, plain.action_space.high, (8, 1, 6))
    for told, reaching in zip(actions, [stand] * 3 + list(actions), strict=False):
        late.step(told)
        plain.step(reaching)
        assert np.array_equal(late.task.state.action, reaching)
        assert np.array_equal(late.task.state.joint_positions, plain.task.state.joint_positions)


def held(env, decisions=60):
    """The arm's home, held until it is still."""
    env.reset(seed=0)
    for _ in range(decisions):
        env.step(env.task.arm.description.home[None])
    return env.task.simulation.data(0)


def test_the_servos_bear_a_payloads_weight_and_give_way_to_it():
    plain, loaded = worlds(), worlds(disturbances={"payload": 4.0})
    unloaded, data = held(plain), held(loaded)
    model = plain.task.simulation.model
    tip = model.body("arm/" + plain.task.arm.description.tip).id
    at_rest, jacobian = mujoco.MjData(model), np.zeros((3, model.nv))
    at_rest.qpos[:] = data.qpos
    mujoco.mj_forward(model, at_rest)
    mujoco.mj_jacBody(model, at_rest, jacobian, None, tip)
    weight = jacobian.T @ [0.0, 0.0, 4.0 * 9.81]
    np.testing.assert_allclose(data.qfrc_actuator, at_rest.qfrc_bias + weight, atol=0.01)
    assert data.xpos[tip][2] < unloaded.xpos[tip][2] - 0.001


def test_a_loaded_rover_is_the_rover_with_a_ball_on_top_and_weighs_as_much():
    env = worlds(BRIDGE, disturbances={"payload": 20.0})
    spec = mujoco.MjSpec.from_file(str(world_path("rover")))
    spec.body("base").add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.05, 0, 0], pos=[0, 0, 0.22], mass=20.0)
    expected = spec.compile().body("base")
    base = env.task.simulation.model.body("rover/base").id
    for field in ("mass", "ipos", "inertia"):
        found = np.sort(np.ravel(fields(env, f"body_{field}")[0, base]))
        np.testing.assert_allclose(found, np.sort(np.ravel(getattr(expected, field))), rtol=1e-9, atol=1e-12)
    for _ in range(30):
        env.step(np.zeros((1, 2)))
    simulation, force = env.task.simulation, np.zeros(6)
    data, normal = simulation.data(0), 0.0
    for contact in range(data.ncon):
        mujoco.mj_contactForce(simulation.model, data, contact, force)
        normal += force[0]
    np.testing.assert_allclose(normal, 9.81 * (20.0 + sum(spec.compile().body_mass) - 20.0), rtol=0.01)


def test_dry_friction_holds_joints_against_less_torque():
    env = worlds(control="torque", disturbances={"friction": 0.5})
    effort = env.task.arm.description.limits.effort
    assert np.array_equal(fields(env, "dof_frictionloss")[0], 0.5 * effort)
    for share, moves in ((0.4, False), (0.6, True)):
        env.reset(seed=0)
        before = env.task.state.joint_positions.copy()
        env.step(share * effort[None])
        assert (np.abs(env.task.state.joint_positions - before).max() > 1e-2) == moves


def test_smooth_tyres_take_longer_to_get_going():
    speeds = []
    for disturbances in (None, {"friction": 0.1}):
        env = worlds(BRIDGE, disturbances=disturbances)
        for _ in range(3):
            env.step(np.array([[2.0, 0.0]]))
        speeds.append(env.task.state.velocities[0, 0])
    tyres = [env.task.simulation.model.geom(f"rover/{wheel}").id for wheel in WHEELS]
    np.testing.assert_allclose(fields(env, "geom_friction")[0, tyres, 0], 0.09)
    assert speeds[1] < 0.5 * speeds[0]


@pytest.mark.parametrize("env", [REACH, BRIDGE])
def test_weak_motors_bring_that_share_of_the_torque(env):
    forces = []
    for disturbances in (None, {"strength": 0.4}):
        simulation = worlds(env, disturbances=disturbances).task.simulation
        force = simulation.array("qfrc_actuator")
        simulation.array("act")[:] += 0.01
        simulation.array("ctrl")[:] = 0.2
        simulation.array("qvel")[:] = -0.01
        simulation.step(1)
        forces.append(force[0].copy())
    assert np.abs(forces[0]).max() > 0.1
    np.testing.assert_allclose(forces[1], 0.4 * forces[0], rtol=1e-12)


def test_weak_motors_cannot_hold_what_strong_ones_can():
    plain, weak = (held(worlds(disturbances={"strength": share}), 25) for share in (0.9, 0.1))
    assert weak.body("arm/ee_link").xpos[2] < plain.body("arm/ee_link").xpos[2] - 0.1
    assert np.abs(weak.qfrc_actuator).max() <= 15.0 + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("env", "period"), [(REACH, 0.04), pytest.param(BRIDGE, 0.1, marks=pytest.mark.slow)])
def test_pushes_come_once_a_second_with_their_impulse_whatever_the_policy_does(env, period):
    told = []
    for share in (0.0, 1.0):
        made = worlds(env, 100, {"pushes": 3.0}, autoreset_mode="disabled")
        body = made.task.simulation.model.body("rover/base" if env == BRIDGE else "arm/ee_link").id
        forces = []
        for _ in range(20):
            made.step(np.tile(share * made.single_action_space.high, (100, 1)))
            applied = made.task.simulation.array("xfrc_applied").copy()
            forces.append(applied[:, body].copy())
            applied[:, body] = 0
            assert not applied.any()
        told.append(np.array(forces))
    assert np.array_equal(told[0], told[1])
    impulses = np.linalg.norm(told[0], axis=-1) * period
    pushed = impulses > 0
    np.testing.assert_allclose(impulses[pushed], 3.0)
    assert abs(pushed.mean() - period) < 4 * np.sqrt(period * (1 - period) / pushed.size)
    directions = told[0][pushed][:, :3] * period / 3.0
    assert np.abs(directions.mean(axis=0)).max() < 4 / np.sqrt(len(directions))
    assert (directions[:, 2] == 0).all() == (env == BRIDGE)


@pytest.mark.slow
@pytest.mark.parametrize(("env", "impulse"), [(REACH, 40.0), (BRIDGE, 20.0)])
def test_pushes_move_the_robot(env, impulse):
    still = {REACH: lambda made: made.task.arm.description.home, BRIDGE: lambda made: np.zeros(2)}[env]
    moved = []
    for disturbances in (None, {"pushes": impulse}):
        made = worlds(env, 20, disturbances)
        start = made.task.motion().position
        farthest = np.zeros(20)
        for _ in range(15):
            made.step(np.tile(still(made), (20, 1)))
            farthest = np.maximum(farthest, np.linalg.norm(made.task.motion().position - start, axis=1))
        moved.append(farthest)
    assert (moved[1] > moved[0] + 0.02).sum() >= 5


@pytest.mark.slow
def test_lost_pictures_are_black_and_of_the_share_asked_for():
    plain, worse = worlds(BRIDGE, 60), worlds(BRIDGE, 60, {"dropout": 0.3})
    blacked = []
    for _ in range(10):
        truth, seen = (env.step(np.full((60, 2), 0.2))[0] for env in (plain, worse))
        black = (seen["image"] == 0).all(axis=(1, 2))
        assert np.array_equal(seen["image"][~black], truth["image"][~black])
        assert np.array_equal(seen["motion"], truth["motion"])
        blacked.append(black)
    lost = np.array(blacked)
    assert abs(lost.mean() - 0.3) < 4 * np.sqrt(0.3 * 0.7 / lost.size)
    assert (lost.any(axis=0) & ~lost.all(axis=0)).sum() > 40


def test_lost_pictures_have_no_ranges():
    worse = worlds(BRIDGE, 40, {"dropout": 0.3}, observation="ranges", dynamics="kinematic")
    ranges = worse.step(np.full((40, 2), 0.2))[0]["ranges"]
    lost = (ranges == 0).all(axis=1)
    assert 2 < lost.sum() < 25
    assert (ranges[~lost] > 0).all()


def test_a_mismatched_arm_is_not_what_controllers_believe_it_is():
    env, plain = worlds(n=2, disturbances={"mismatch": 0.1}), worlds(n=2)
    description = env.task.arm.description
    believed = ArmModel(description).positions(env.task.state.joint_positions)
    off = np.linalg.norm(believed - env.task.state.end_effector_position, axis=1)
    assert ((off > 0.001) & (off < 0.2)).all()
    np.testing.assert_allclose(believed, plain.task.state.end_effector_position, atol=1e-6)
    model = plain.task.simulation.model
    links = [i for i in range(model.nbody) if model.body(i).name.startswith("arm/") and model.body_mass[i] > 0]
    masses, held = fields(env, "body_mass")[:, links], fields(env, "body_gravcomp")[:, links]
    shares = masses / model.body_mass[links]
    assert ((shares >= 0.9) & (shares <= 1.1)).all()
    assert np.abs(shares[0] - shares[1]).max() > 0.01
    np.testing.assert_allclose(masses * held, np.tile(model.body_mass[links], (2, 1)))
    before = masses.copy()
    env.reset()
    assert not np.isclose(fields(env, "body_mass")[:, links], before).any()
    env.reset(seed=0)
    assert np.array_equal(fields(env, "body_mass")[:, links], before)


@pytest.mark.parametrize(("env", "body", "mass"), [(REACH, "arm/ee_link", 0.0), (BRIDGE, "rover/base", 16.523)])
def test_a_mismatch_leaves_payload_and_weakness_what_they_are(env, body, mass):
    made = worlds(env, 3, {"payload": 4.0, "strength": 0.5, "mismatch": 0.1})
    index = made.task.simulation.model.body(body).id
    shares = fields(made, "body_mass")[:, index] / (mass + 4.0)
    assert ((shares > 0.9) & (shares < 1.1) & (shares != 1)).all()
    if env == REACH:
        forearm = made.task.simulation.model.body("arm/forearm_link")
        held = fields(made, "body_gravcomp") * fields(made, "body_mass")
        np.testing.assert_allclose(held[:, forearm.id], 0.5 * 2.275, rtol=1e-6)
        np.testing.assert_allclose(held[:, index], 0.0, atol=1e-12)


def test_a_mismatched_rover_has_other_wheels_and_does_not_drive_straight():
    env, plain = worlds(BRIDGE, 4, {"mismatch": 0.2}), worlds(BRIDGE, 4)
    wheels = [env.task.simulation.model.geom(f"rover/{wheel}").id for wheel in WHEELS]
    radii = fields(env, "geom_size")[:, wheels, 0] / WHEEL_RADIUS
    assert ((radii >= 0.8) & (radii <= 1.2)).all()
    assert radii.std() > 0.05
    for _ in range(25):
        env.step(np.tile([1.0, 0.0], (4, 1)))
        plain.step(np.tile([1.0, 0.0], (4, 1)))
    assert np.abs(plain.task.state.poses[:, 2]).max() < 0.02
    assert np.abs(env.task.state.poses[:, 2]).max() > 0.1


@pytest.mark.parametrize(
    ("env", "options", "says"),
    [
        (REACH, {"disturbances": {"payloads": 2.0}}, "Did you mean 'payload'"),
        (REACH, {"disturbances": {"dropout": 0.5}}, "no disturbance here 'dropout'"),
        (BRIDGE, {"disturbances": {"dropout": 0.5}, "observation": "state"}, "no disturbance here 'dropout'"),
        (BRIDGE, {"disturbances": {"dropout": 1.5}}, "from 0 to 1"),
        (REACH, {"disturbances": {"noise": -0.1}}, "noise is a number from 0"),
        (REACH, {"disturbances": {"noise": np.nan}}, "not nan"),
        (REACH, {"disturbances": {"payload": np.inf}}, "not inf"),
        (REACH, {"disturbances": {"payload": "heavy"}}, "not 'heavy'"),
        (REACH, {"disturbances": {"payload": None}}, "not None"),
        (REACH, {"disturbances": {"strength": True}}, "not True"),
        (REACH, {"disturbances": {"delay": 1.5}}, "delay is a whole number"),
        (REACH, {"disturbances": "noise"}, "levels by name"),
        (REACH, {"disturbance": {"noise": 0.1}}, "Did you mean 'disturbances'"),
    ],
)
def test_unusable_levels_say_what_is_allowed(env, options, says):
    with pytest.raises(ConfigurationError, match=says):
        gymnasium.make_vec(env, num_envs=1, **options)
    with pytest.raises(ConfigurationError, match=says):
        gymnasium.make(env, **options)


@pytest.mark.one_case
@pytest.mark.parametrize(("env", "name"), [(REACH, name) for name in ARM] + [(BRIDGE, name) for name in ROVER])
def test_the_most_that_is_allowed_is_survived(env, name):
    kind = (ARM if env == REACH else ROVER)[name]
    for level in (0, kind.highest):
        made = worlds(env, 2, {name: level})
        observations = played(made, 5)
        assert all(np.isfinite(values).all() for values in observations)

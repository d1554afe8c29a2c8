"""The model in which policies plan: rollouts are the environment's own steps, and change nothing in it."""

from typing import Any

import mujoco
import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError
from armctl.envs import Interface, make_worlds
from armctl.policies import make_policy
from armctl.simulation.history import WHOLE

from ..holding_still import Still

REACH, BRIDGE = "armctl/ArmReach-v0", "armctl/BridgeCross-v0"
STEPS, SEQUENCES = 4, 3


def begun(env, n=SEQUENCES, **options):
    worlds: Any = make_worlds(env, n, options)
    worlds.reset(seed=[3] * n)
    return worlds


def fields_of(simulation, *names):
    return [simulation.array(name).copy() for name in names]


@pytest.mark.parametrize(
    ("env", "options"),
    [
        pytest.param(REACH, {"control": "position"}, id="position"),
        pytest.param(REACH, {"control": "velocity"}, id="velocity"),
        pytest.param(REACH, {"control": "torque"}, id="torque"),
        pytest.param(REACH, {"control": "relative", "actions": "normalized"}, id="normalized"),
        pytest.param(BRIDGE, {"observation": "state"}, id="rover"),
    ],
)
def test_a_rollout_makes_the_steps_of_the_environment(env, options):
    worlds = begun(env, **options)
    simulation, space = worlds.task.simulation, worlds.single_action_space
    positions = simulation.array("xpos")
    actions = np.random.default_rng(0).uniform(space.low, space.high, (SEQUENCES, STEPS, *space.shape))
    worlds.step(actions[:, 0])  # drives move, and contacts are warm
    start = simulation.live_arrays["state"].copy()
    model = worlds.model()
    motion = model.rollout(start, actions)
    single = model.rollout(start[1], actions[1:2])
    assert np.array_equal(simulation.live_arrays["state"], start)
    for k in range(STEPS):
        worlds.step(actions[:, k])
        for predicted, name in ((motion.qpos, "qpos"), (motion.qvel, "qvel"), (motion.states, "state")):
            true = simulation.live_arrays["state"] if name == "state" else simulation.array(name)
            np.testing.assert_allclose(predicted[:, k], true, rtol=0, atol=1e-9 if env == BRIDGE else 0)
        np.testing.assert_allclose(motion.xpos[:, k, -1], positions[:, -1], atol=1e-9)
    assert np.array_equal(single.states[0], motion.states[1])
    assert motion.qpos.shape[:2] == (SEQUENCES, STEPS)
    assert not motion.unstable.any()
    model.mujoco.opt.gravity[2] = -5.0  # a change counts
    assert not np.array_equal(model.rollout(start, actions).qpos, motion.qpos)
    assert np.ptp(motion.qpos[:, -1], axis=0).max() > 1e-3  # sequences differ


def test_a_state_is_made_of_beliefs():
    worlds = begun(REACH, observation="full")
    model, simulation = worlds.model(), worlds.task.simulation
    actions = np.random.default_rng(1).uniform(-1, 1, (SEQUENCES, STEPS, 6))
    worlds.step(actions[:, 0])
    commands = np.hstack(worlds.task.arm.drive_commands)[1]
    q, velocity = fields_of(simulation, "qpos", "qvel")
    ctrl = np.tile(commands[6:], 2)
    believed = model.state(qpos=q[1], qvel=velocity[1], act=commands[:6], ctrl=ctrl)
    truth = model.rollout(simulation.live_arrays["state"][1], actions[1:2])
    np.testing.assert_allclose(model.rollout(believed, actions[1:2]).qpos, truth.qpos, atol=1e-9)
    resting = model.state(qpos=q[1])
    held = model.rollout(resting, np.tile(q[1], (1, STEPS, 1)))
    np.testing.assert_allclose(held.qpos[0], np.tile(q[1], (STEPS, 1)), atol=1e-6)
    assert np.array_equal(model.state(base=believed), believed)
    with pytest.raises(ConfigurationError, match=r"no field of a state 'qposs'.*Did you mean 'qpos'"):
        model.state(qposs=q[1])
    with pytest.raises(ConfigurationError, match=r"qpos of a state has shape \(6,\), not \(5,\)"):
        model.state(qpos=q[1, 1:])
    with pytest.raises(ConfigurationError, match="actions have shape"):
        model.rollout(believed, actions[0])


def test_a_rollout_in_an_environment_of_others_makes_its_steps():
    worlds: Any = make_worlds("Reacher-v5", 1)
    model = worlds.model()
    worlds.reset(seed=3)
    data = worlds.worlds[0].unwrapped.data
    start = np.empty(mujoco.mj_stateSize(model.mujoco, WHOLE))
    mujoco.mj_getState(model.mujoco, data, start, WHOLE)
    actions = np.random.default_rng(0).uniform(-1, 1, (1, STEPS, 2))
    motion = model.rollout(start, actions)
    by_beliefs = model.rollout(model.state(qpos=data.qpos, qvel=data.qvel), actions)
    for k in range(STEPS):
        worlds.step(actions[:, k])
        for predicted in (motion, by_beliefs):
            np.testing.assert_allclose(predicted.qpos[0, k], data.qpos, atol=1e-9)
            np.testing.assert_allclose(predicted.qvel[0, k], data.qvel, atol=1e-9)
    assert model.control_period == pytest.approx(0.02)
    assert model.upper.tolist() == [1, 1]


def test_an_environment_with_other_steps_than_its_model_has_no_rollouts():
    class Halved(type(make_worlds("Reacher-v5", 1).worlds[0].unwrapped)):  # type: ignore[misc]
        def step(self, action):
            return super().step(action / 2)

    from armctl.envs.imagined import planning_model

    env: Any = Halved()
    model = planning_model(env, env.action_space, None, env.model)
    with pytest.raises(ConfigurationError, match="does not tell how its actions move its robot"):
        model.rollout(model.state(), np.zeros((1, 1, 2)))


def planner(given, **declaration):
    @armctl.sees("model", **declaration)
    def make(env):
        model = env.model()
        given.append(model)
        model.mujoco.opt.gravity[:] = 0
        model.mujoco.body_mass[:] = 100
        still = Still("model", act=lambda: model.rollout(model.state(), np.zeros((2, 2, 6))))
        return still

    return make


def test_the_model_is_for_who_declares_it_and_leads_nowhere():
    given: list[Any] = []
    worlds: Any = make_worlds(REACH, 1, {"disturbances": {"payload": 2.0}})
    with pytest.raises(ConfigurationError, match=r'nominal simulator is only for .*foresight="simulator"'):
        make_policy(planner(given), worlds)
    policy = make_policy(planner(given, foresight="simulator"), worlds)
    observations, _ = worlds.reset(seed=0)
    before = {name: values.copy() for name, values in worlds.task.simulation.live_arrays.items()}
    policy.act(observations)
    for name, values in worlds.task.simulation.live_arrays.items():
        assert np.array_equal(values, before[name])
    assert worlds.task.simulation.model.opt.gravity[2] < -9
    assert worlds.model().mujoco.body_mass.max() < 100
    assert worlds.model().mujoco is not worlds.model().mujoco
    with pytest.raises(ConfigurationError, match="has no model of MuJoCo's"):
        make_worlds("CartPole-v1", 1).model()


def test_a_policy_in_a_process_of_its_own_gets_the_model():
    import cloudpickle

    given: list[Any] = []
    worlds: Any = make_worlds(REACH, 1)

    @armctl.sees("model", foresight="simulator")
    def make(env):
        given.append(env)
        return Still("model")

    make_policy(make, worlds)
    sent: Interface = cloudpickle.loads(cloudpickle.dumps(given[0]))
    state = sent.model().state()
    assert np.array_equal(
        sent.model().rollout(state, np.zeros((1, 2, 6))).states,
        worlds.model().rollout(state, np.zeros((1, 2, 6))).states,
    )

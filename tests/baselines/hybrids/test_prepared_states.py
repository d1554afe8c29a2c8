import numpy as np
import pytest

from armctl.baselines.hybrids.prepared_states import PreparedStates
from armctl.envs import make_worlds
from armctl.tasks.bridge.observation import BLOCK, ROVER, WALKER
from armctl.tasks.bridge.planar import Geometry

ENV = "armctl/BridgeCrossMoving-v0"
COMMANDS = np.tile([1.0, 0.2], (4, 1))


def prepared(disturbances):
    worlds = make_worlds(ENV, 4, {"disturbances": disturbances})
    worlds.reset(seed=1)
    states = PreparedStates(worlds, Geometry.of(worlds.task.options, worlds.task.simulation.model).turn)
    states.reset(np.arange(4, dtype=np.int32))
    return worlds, states


def drive(bridges, steps):
    """What is observed of each control step, and what is true then, (steps, n, k)."""
    (worlds, states), observed, truth = bridges, [], []
    for _ in range(steps):
        observed.append(states.observe())
        truth.append(worlds.task.state_observation())
        worlds.step(states.command(COMMANDS).astype(np.float32))
    worlds.close()
    return np.array(observed), np.array(truth)


def test_without_disturbances_states_are_as_they_are():
    observed, truth = drive(prepared({}), 5)
    np.testing.assert_allclose(observed, truth, atol=1e-5)


def test_under_a_delay_states_are_those_in_which_commands_act():
    observed, truth = drive(prepared({"delay": 2}), 14)
    later, too_early = truth[12:14], truth[10:12]
    assert np.abs(observed[10:12] - later)[..., :2].max() < 0.03
    assert np.abs(too_early - later)[..., 0].max() > 0.15


@pytest.mark.parametrize("level", [0.1, 0.2])
def test_estimates_are_nearer_to_the_truth_than_readings(level):
    worlds, states = prepared({"noise_on_state": level})
    readings = []
    observe = states.observe
    states.observe = lambda: (readings.append(worlds.perceived().state_observation()), observe())[1]
    observed, truth = drive((worlds, states), 25)
    error, of_readings = (np.abs(values - truth)[15:].mean(axis=(0, 1)) for values in (observed, np.array(readings)))
    blocks = ROVER + BLOCK * worlds.task.options.blocks
    assert error[:2].mean() < 0.7 * of_readings[:2].mean()
    assert error[ROVER:blocks].mean() < 0.5 * of_readings[ROVER:blocks].mean()
    places = error[blocks:].reshape(-1, WALKER)[:, :2]
    assert places.mean() < 0.85 * of_readings[blocks:].reshape(-1, WALKER)[:, :2].mean()

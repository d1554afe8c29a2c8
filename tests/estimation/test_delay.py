import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armctl.core.errors import ConfigurationError
from armctl.estimation.delay import DelayOptions, DelayPredictor

PERIOD, LAG = 0.1, 0.6
SCALE = (np.inf, 0.05)


def law(states, actions):
    """Return position and velocity of carts whose velocity follows the action."""
    velocity = states[..., 1] + LAG * (actions[..., 0] - states[..., 1])
    return np.stack((states[..., 0] + PERIOD * velocity, velocity), axis=-1)


def drive(predictor, delays, actions, noise=0.0, rng=None, spoil=lambda step, states: states):
    """Play actions (t, n, 1) on carts with true delays (n,); return the believed delays (t, n) and the states."""
    states, line, beliefs, places = np.zeros((len(delays), 2)), [], [], []
    for step, sent in enumerate(actions):
        readings = states + (noise * rng.standard_normal(states.shape) if noise else 0.0)
        predictor.read(spoil(step, readings))
        beliefs.append(predictor.delay.copy())
        places.append((states, predictor.predict(states)))
        predictor.send(sent)
        line.append(sent)
        acting = [line[step - d][i] if step >= d else np.zeros(1) for i, d in enumerate(delays)]
        states = law(states, np.array(acting))
    return np.array(beliefs), places


def random_actions(rng, steps, n):
    return np.repeat(rng.uniform(-1, 1, (steps // 4 + 1, n, 1)), 4, axis=0)[:steps]


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(0, 5), min_size=1, max_size=6), st.integers(0, 2**31))
def test_without_noise_each_delay_is_known_when_the_first_action_has_acted(delays, seed):
    rng = np.random.default_rng(seed)
    actions = random_actions(rng, 30, len(delays))
    actions[:4] = np.where(actions[:4] < 0, -1.0, 1.0)
    predictor = DelayPredictor(law, len(delays), [0.0], SCALE)
    beliefs, places = drive(predictor, delays, actions)
    for i, delay in enumerate(delays):
        assert (beliefs[delay + 1 :, i] == delay).all()
        for step in range(delay + 1, 30 - delay):
            np.testing.assert_allclose(places[step][1][i], places[step + delay][0][i], atol=1e-12)


@pytest.mark.parametrize("noise", [0.05, 0.2])
def test_with_noise_the_delays_are_found_and_kept(noise):
    rng, delays = np.random.default_rng(0), np.tile(np.arange(6), 50)
    predictor = DelayPredictor(law, len(delays), [0.0], SCALE)
    beliefs, _ = drive(predictor, delays, random_actions(rng, 120, len(delays)), noise, rng)
    assert (beliefs[60:] == delays).mean() > 0.99
    assert (np.diff(beliefs[30:], axis=0) != 0).sum(axis=0).mean() < 0.2  # it does not flicker


def test_with_nothing_to_learn_from_the_nominal_delay_stays():
    predictor = DelayPredictor(law, 2, [0.0], SCALE, DelayOptions(nominal=2))
    beliefs, _ = drive(predictor, [0, 4], np.zeros((50, 2, 1)), 0.2, np.random.default_rng(0))
    assert (beliefs == 2).all()


def test_jumps_and_missing_readings_change_nothing():
    def spoil(step, states):
        states = states.copy()
        if 10 <= step < 13:
            states[0] = np.nan
        states[1] += 100.0 * (step >= 12)
        states[2, 1] += 1e6 * (step == 20)
        return states

    actions = random_actions(np.random.default_rng(1), 40, 3)
    predictor = DelayPredictor(law, 3, [0.0], SCALE)
    beliefs, _ = drive(predictor, [3, 3, 3], actions, spoil=spoil)
    assert (beliefs[9:, [0, 2]] == 3).all()
    assert (beliefs[9:12, 1] == 3).all()  # an offset that stays is another law


def test_resets_concern_only_their_robots():
    predictor = DelayPredictor(law, 2, [0.0], SCALE)
    drive(predictor, [3, 3], random_actions(np.random.default_rng(2), 20, 2))
    assert predictor.delay.tolist() == [3, 3]
    predictor.reset(np.array([1]))
    assert predictor.delay.tolist() == [3, 0]
    assert predictor.acting()[1] == 0.0
    states = np.ones((2, 2))
    assert (predictor.predict(states)[1] == states[1]).all()


def test_all_robots_are_identified_as_each_alone():
    rng, delays = np.random.default_rng(3), [0, 2, 5]
    actions, noise = random_actions(rng, 60, 3), 0.1 * rng.standard_normal((60, 3, 2))
    together, _ = drive(DelayPredictor(law, 3, [0.0], SCALE), delays, actions, spoil=lambda k, x: x + noise[k])
    for i, delay in enumerate(delays):
        alone, _ = drive(
            DelayPredictor(law, 1, [0.0], SCALE), [delay], actions[:, [i]], spoil=lambda k, x, i=i: x + noise[k, [i]]
        )
        np.testing.assert_array_equal(together[:, [i]], alone)


def test_wrong_arguments_are_named():
    with pytest.raises(ConfigurationError, match="nominal delay should be at most max_delay"):
        DelayPredictor(law, 1, [0.0], SCALE, DelayOptions(nominal=9))
    with pytest.raises(ConfigurationError, match="scale"):
        DelayPredictor(law, 1, [0.0], [0.0, 1.0])

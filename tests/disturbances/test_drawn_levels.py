import gymnasium
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.disturbances import ARM, ROVER, Disturbance, DisturbanceSpec, disturb
from armctl.envs import make_worlds
from tests.disturbances.disturbed import BRIDGE, REACH, check_single_environments, fields, played, worlds

RANGES = {
    REACH: {
        "noise": (0.0, 0.02), "delay": (0, 3), "payload": (0.0, 5.0), "friction": (0.0, 0.2), "strength": (0.5, 1.0),
        "pushes": (0.0, 10.0), "mismatch": (0.0, 0.1),
    },
    BRIDGE: {
        "noise": (0.0, 0.2), "noise_on_state": (0.0, 0.2),
        "delay": (0, 2), "payload": (0.0, 20.0), "friction": (0.5, 1.0), "strength": (0.6, 1.0),
        "pushes": (0.0, 10.0), "mismatch": (0.0, 0.1), "dropout": (0.0, 0.5),
    },
}  # fmt: skip
CASES = [(env, name) for env in RANGES for name in RANGES[env]]


def model_of(env):
    """All that is each world's own of the physical model, besides its state; without cameras and lights."""
    live = env.unwrapped.task.simulation.live_arrays
    left_out = ("state", "unstable", "cam_", "light_")
    return {name: values.copy() for name, values in live.items() if not name.startswith(left_out)}


def test_ranges_are_of_all_disturbances():
    assert {env: set(ranges) for env, ranges in RANGES.items()} == {REACH: set(ARM), BRIDGE: set(ROVER)}


@pytest.mark.one_case
@pytest.mark.parametrize(("env", "name"), CASES)
def test_each_episode_is_that_of_its_level_fixed(env, name):
    low, high = RANGES[env][name]
    drawn = worlds(env, 1, {name: (low, high)}, autoreset_mode="disabled")
    levels = []
    for episode in (4, 0):
        drawn.reset(seed=3, options={"episode": episode})
        levels.append(float(drawn.disturbances[name].levels[0]))
        fixed = worlds(env, 1, {name: levels[-1]}, autoreset_mode="disabled")
        fixed.reset(seed=3, options={"episode": episode})
        model = model_of(fixed)
        assert all(np.array_equal(values, model[field]) for field, values in model_of(drawn).items() if field in model)
    assert levels[0] != levels[1]
    assert all(np.array_equal(a, b) for a, b in zip(played(drawn, 8), played(fixed, 8), strict=True))


@pytest.mark.parametrize("env", RANGES)
def test_all_ranges_at_once_depend_on_seed_and_episode_alone(env):
    check_single_environments(env, RANGES[env], decisions=6)


def test_a_world_that_is_reset_leaves_others_their_levels():
    env = worlds(n=2, disturbances=RANGES[REACH], autoreset_mode="disabled")
    before, model = {name: one.levels.copy() for name, one in env.disturbances.items()}, model_of(env)
    env.reset(options={"reset_mask": np.array([True, False])})
    for name, one in env.disturbances.items():
        assert one.levels[1] == before[name][1]
    assert any(one.levels[0] != before[name][0] for name, one in env.disturbances.items())
    assert all(np.array_equal(values[1], model[field][1]) for field, values in model_of(env).items())


@pytest.mark.parametrize(("name", "given"), [("noise", (0.01, 0.03)), ("delay", (1, 3))])
def test_levels_are_uniform_over_their_range(name, given):
    env = worlds(n=400, disturbances={name: given})
    levels = env.disturbances[name].levels
    low, high = given
    assert low <= levels.min() < levels.max() <= high
    spread = high - low + (name == "delay")
    assert abs(levels.mean() - (low + high) / 2) < 4 * spread / np.sqrt(12 * 400)
    if name == "delay":
        assert set(levels) == {1.0, 2.0, 3.0}


def test_a_payload_that_differs_leaves_weakness_and_mismatch_what_they_are():
    env = worlds(n=4, disturbances={"payload": (0.0, 4.0), "strength": 0.5, "mismatch": 0.1})
    env.reset()
    model = env.task.simulation.model
    tip, forearm = model.body("arm/ee_link").id, model.body("arm/forearm_link").id
    shares = fields(env, "body_mass")[:, tip] / env.disturbances["payload"].levels
    assert ((shares > 0.9) & (shares < 1.1)).all()
    held = fields(env, "body_gravcomp") * fields(env, "body_mass")
    np.testing.assert_allclose(held[:, forearm], 0.5 * 2.275, rtol=1e-6)


def test_a_range_of_one_level_is_that_level():
    ranged, fixed = (worlds(n=2, disturbances={"noise": given}) for given in ([0.02, 0.02], 0.02))
    assert all(np.array_equal(a, b) for a, b in zip(played(ranged, 5), played(fixed, 5), strict=True))
    assert not worlds(disturbances={"strength": (1, 1)}).disturbances


def test_environments_of_others_draw_levels_too():
    env = make_worlds("Pendulum-v1", 3, {"disturbances": {"noise": (0.0, 0.5), "delay": (0, 3)}})
    seen, _ = env.reset(seed=1)
    assert len(set(env.disturbances["noise"].levels)) == 3
    env.reset(seed=7)
    again, _ = env.reset(seed=1)
    np.testing.assert_equal(seen, again)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"noize": (0, 1)}, "Did you mean 'noise'"),
        ({"noise": (0.02, 0.01)}, "from the lowest to the highest"),
        ({"noise": (-0.1, 0.1)}, "noise is a number from 0"),
        ({"noise": (0, 11)}, "noise is a number from 0 to 10"),
        ({"noise": (0, np.nan)}, "not nan"),
        ({"noise": (0, "loud")}, "not 'loud'"),
        ({"noise": (0,)}, "a pair of the lowest and the highest"),
        ({"noise": [0, 0.01, 0.02]}, "a pair of the lowest and the highest"),
        ({"noise": ((0, 1), 2)}, "noise is a number"),
        ({"delay": (0, 1.5)}, "delay is a whole number"),
    ],
)
def test_unusable_ranges_say_what_is_allowed(given, says):
    with pytest.raises(ConfigurationError, match=says):
        gymnasium.make_vec(REACH, num_envs=1, disturbances=given)


def test_a_disturbance_whose_level_is_one_for_all_says_so():
    specs = {"coarse": DisturbanceSpec(Disturbance, "nothing", "-", (0.0, 1.0), 1.0)}
    task = worlds().task
    assert disturb(task, specs, {"coarse": 0.5})["coarse"].level == 0.5
    with pytest.raises(ConfigurationError, match="the level of coarse cannot differ between episodes"):
        disturb(task, specs, {"coarse": (0.0, 0.5)})

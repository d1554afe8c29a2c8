"""What every learner may rely on: spaces, infos, actions, and copies, for all environments and interfaces."""

import pickle
import warnings
from typing import Any

import cloudpickle
import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_env_for_stable_baselines

from armctl.core.errors import ConfigurationError, UnknownOption

REACH = ("armctl/ArmReach-v0", "armctl/ArmReachMoving-v0", "armctl/ArmReachObstacles-v0")
BRIDGE = ("armctl/BridgeCross-v0", "armctl/BridgeCrossMoving-v0")
SMALL = {"resolution": (8, 6)}
LEARNER = {"actions": "normalized", "control": "relative", "observation": "features"}
INTERFACES = [
    *((env, {"observation": name}) for env in REACH for name in ("paper", "features", "full")),
    *((env, LEARNER) for env in REACH),
    *(("armctl/ArmLift-v0", {"observation": name}) for name in ("paper", "features", "full")),
    *(("armctl/ArmPose-v0", {"observation": name}) for name in ("paper", "features", "full")),
    *(("armctl/ArmPush-v0", {"observation": name}) for name in ("paper", "features", "full")),
    *(("armctl/ArmScenes-v0", {"observation": name}) for name in ("paper", "features", "full")),
    ("armctl/BarnCross-v0", {"observation": "full"}),
    ("armctl/BarnCrossMoving-v0", {"observation": "full"}),
    (REACH[0], {**LEARNER, "goal": True}),
    (REACH[0], {"control": "torque", "observation": "full", "actions": "normalized"}),
    *((env, {"observation": name, **SMALL}) for env in BRIDGE for name in ("paper", "features", "full", "image")),
    (BRIDGE[0], {"camera": "classes", "image_format": "uint8", **SMALL}),
    (BRIDGE[1], {"actions": "normalized", "observation": "features", "image_format": "uint8", **SMALL}),
]
MODES = ("next_step", "same_step", "disabled")


def vector(env, n=3, **options):
    return gymnasium.make_vec(env, num_envs=n, threads=1, **options)


@pytest.mark.one_case
@pytest.mark.parametrize(("env", "options"), INTERFACES)
def test_checkers_pass_without_a_warning(env, options):
    """But for two that say that physical units are no convention, and one about images that are no pictures."""
    made = gymnasium.make(env, **options)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if options.get("actions") != "normalized":
            warnings.filterwarnings("ignore", message=".*normalize the action space|.*symmetric and normalized.*")
            warnings.filterwarnings("ignore", message=".*not normalized.*")
        if env in BRIDGE and "image_format" not in options:
            warnings.filterwarnings("ignore", message=".*unconventional shape.*")
        warnings.filterwarnings("ignore", message=".*smaller than 36x36.*|.*minimal resolution.*")
        check_env(made.unwrapped, skip_render_check=True)
        check_env_for_stable_baselines(made.unwrapped, skip_render_check=True)


@pytest.mark.one_case
@pytest.mark.parametrize(("env", "options"), INTERFACES)
def test_every_number_observed_is_within_finite_bounds(env, options, sized):
    worlds = vector(env, 8, max_episode_steps=40, **options)
    space, one = worlds.observation_space, worlds.single_observation_space
    parts = one.spaces.values() if isinstance(one, gymnasium.spaces.Dict) else (one,)
    assert all(np.isfinite(part.low).all() and np.isfinite(part.high).all() for part in parts)
    worlds.action_space.seed(1)
    assert space.contains(worlds.reset(seed=1)[0])
    for _ in range(sized(60, 90)):  # of episodes of 40 steps
        assert space.contains(worlds.step(worlds.action_space.sample())[0])


@pytest.mark.one_case
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("env", "options"), [(REACH[0], {}), (REACH[1], {}), (REACH[2], {}), (BRIDGE[0], SMALL)])
@pytest.mark.parametrize("flat", [False, True])
def test_infos_have_the_same_keys_and_types_from_reset_and_step_and_finite_numbers(env, options, mode, flat):
    worlds = vector(env, autoreset_mode=mode, max_episode_steps=2, flat_infos=flat, **options)

    def kinds(infos):
        shared = {name: value for name, value in infos.items() if "final" not in name}
        return {name: kinds(value) if isinstance(value, dict) else value.dtype for name, value in shared.items()}

    def numbers(infos):
        for value in infos.values():
            yield from numbers(value) if isinstance(value, dict) else [value]

    _, infos = worlds.reset(seed=0)
    expected = kinds(infos)
    assert flat == ("reward_terms" not in expected)
    for _ in range(5):
        *_, infos = worlds.step(np.zeros(worlds.action_space.shape))
        assert kinds(infos) == expected
        assert all(np.isfinite(value).all() for value in numbers({k: v for k, v in infos.items() if "final" not in k}))


def test_the_outcome_is_running_until_an_episode_ends():
    worlds = vector(REACH[0], max_episode_steps=3, autoreset_mode="same_step")
    _, infos = worlds.reset(seed=0)
    seen = [infos]
    for _ in range(4):
        *_, infos = worlds.step(np.zeros((3, 6)))
        seen.append(infos)
    assert [worlds.outcomes[one["outcome_id"][0]] for one in seen] == ["running"] * 3 + ["timeout", "running"]


@pytest.mark.one_case
@pytest.mark.parametrize("env", [*REACH, BRIDGE[0], pytest.param(BRIDGE[1], marks=pytest.mark.slow)])
def test_crashing_at_once_is_worth_less_than_standing_still(env, sized):
    """Without discount, and with any other."""
    options = {} if env in REACH else {"observation": "state"}
    worlds = vector(env, sized(4, 8), autoreset_mode="disabled", **options)
    space, task = worlds.single_action_space, worlds.task
    crash = np.where(np.arange(space.shape[0]) == 1, np.pi / 2, task.idle_action) if env in REACH else [2.0, 1.5]
    discounts = np.array([[1.0], [0.999], [0.99], [0.9]])
    (still, _), (crashed, failed) = (
        _discounted(worlds, np.tile(action, (worlds.num_envs, 1)), discounts) for action in (task.idle_action, crash)
    )
    if env in (REACH[2], *BRIDGE):
        assert failed.any()
    assert (crashed[:, failed] <= still[:, failed] + 1e-9).all()


def _discounted(worlds, actions, discounts):
    """Returns by each discount (one a row), and whether each episode ended in a failure."""
    n = worlds.num_envs
    worlds.reset(seed=3)
    total, running, failed = np.zeros((len(discounts), n)), np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
    for step in range(worlds.max_episode_steps):
        _, rewards, terminated, truncated, infos = worlds.step(actions)
        total += discounts**step * rewards * running
        failed |= running & terminated & ~infos["is_success"]
        running &= ~(terminated | truncated)
        if not running.any():
            break
    return total, failed


def test_what_is_paid_once_is_paid_once():
    worlds = vector(REACH[2], 4, autoreset_mode="disabled")
    worlds.reset(seed=0)
    paid = np.zeros(4)
    for _ in range(60):
        *_, infos = worlds.step(np.tile([0, np.pi / 2, 0, 0, 0, 0], (4, 1)))
        paid += infos["reward_terms"]["collision"] != 0
    assert paid.max() == 1


def test_normalized_actions_are_the_physical_ones_rescaled():
    for env in (REACH[0], BRIDGE[0]):
        options = {} if env in REACH else {"observation": "state"}
        normalized, physical = vector(env, actions="normalized", **options), vector(env, **options)
        low, high = physical.task.action_range
        actions = np.random.default_rng(0).uniform(-1.3, 1.3, (3, len(low)))
        for worlds in (normalized, physical):
            worlds.reset(seed=5)
        seen = normalized.step(actions)
        expected = physical.step(low + (np.clip(actions, -1, 1) + 1) / 2 * (high - low))
        np.testing.assert_allclose(seen[0], expected[0], rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(seen[1], expected[1])
        assert normalized.single_action_space == gymnasium.spaces.Box(-1, 1, (len(low),))
        idle = low + (normalized.idle_action + 1) / 2 * (high - low)
        np.testing.assert_allclose(idle, np.clip(physical.idle_action, low, high), atol=1e-6)


def test_relative_commands_are_position_commands_from_where_the_arm_is():
    relative, absolute = vector(REACH[0], control="relative"), vector(REACH[0])
    seen, _ = relative.reset(seed=5)
    absolute.reset(seed=5)
    rng = np.random.default_rng(0)
    for _ in range(5):
        moves = rng.uniform(-0.8, 0.8, (3, 6))
        present = relative.task.arm.joint_positions.copy()
        limits = relative.task.robot.limits
        goals = np.clip(present + np.clip(moves, -0.5, 0.5), limits.lower, limits.upper)
        seen, expected = relative.step(moves)[0], absolute.step(goals)[0]
        np.testing.assert_allclose(seen, expected, atol=1e-6)


def test_rewards_are_scaled_and_weighted_and_their_terms_are_not():
    scaled, plain = vector(REACH[0], reward_scale=0.04, reward_weights={"step": 0.5}), vector(REACH[0])
    for worlds in (scaled, plain):
        worlds.reset(seed=0)
    _, rewards, _, _, infos = scaled.step(np.zeros((3, 6)))
    _, expected, _, _, others = plain.step(np.zeros((3, 6)))
    np.testing.assert_allclose(rewards, 0.02 * expected)
    assert infos["reward_terms"]["step"].tolist() == others["reward_terms"]["step"].tolist()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"actions": "normalised"}, "Did you mean 'normalized'"),
        ({"reward_scale": 0}, "reward_scale"),
        ({"reward_scale": np.nan}, "reward_scale"),
        ({"reward_weights": [1.0]}, "reward_weights"),
        ({"reward_weights": {"goal": np.nan}}, "'goal' is a finite number"),
        ({"reward_weights": {"gaol": 1.0}}, "Did you mean 'goal'"),
        ({"reward_weights": {"goal": 2.0}, "goal": True}, "leave reward_weights out"),
        ({"observation": "feature"}, "Did you mean 'features'"),
        ({"goal": True, "observation": {"x": lambda state: state.joint_positions}}, "paper, features and full"),
        ({"goal_reward": 0}, "goal_reward"),
        ({"goal_reward": 1.0, "reward": {"x": lambda state: state.distance}}, "the task's own reward"),
        ({"goal": True, "reward": {"x": lambda state: state.distance}}, "function of the goal"),
    ],
)
def test_bad_options_are_told_what_is_allowed(options, message):
    with pytest.raises(ConfigurationError, match=message):
        vector(REACH[0], **options)


@pytest.mark.parametrize("make", [gymnasium.make, vector])
def test_an_unknown_option_is_a_type_error_too(make):
    with pytest.raises(TypeError, match="unexpected keyword argument 'frameskip'") as error:
        make(REACH[0], frameskip=1)
    assert isinstance(error.value, UnknownOption)


@pytest.mark.parametrize("kind", [pickle, cloudpickle])
def test_environments_can_be_pickled(kind):
    options: dict[str, Any] = {"observation": "features", "goal": True, "max_episode_steps": 7}
    worlds, one = vector(REACH[0], **options), gymnasium.make(REACH[0], **options)
    for made in (worlds, one):
        copy = kind.loads(kind.dumps(made))
        assert copy.spec == made.spec
        assert copy.observation_space == made.observation_space
        seen, expected = copy.reset(seed=3)[0], made.reset(seed=3)[0]
        for name in expected:
            np.testing.assert_array_equal(seen[name], expected[name])


@pytest.mark.parametrize("seed", [2**62, 2**63 + 5, 2**64 - 1, 2**100])
def test_seeds_of_any_size_are_obeyed(seed):
    one = gymnasium.make(REACH[0])
    np.testing.assert_array_equal(one.reset(seed=seed)[0], one.reset(seed=seed)[0])
    assert (one.reset(seed=seed)[0] != one.reset(seed=seed + 1)[0]).any()


def test_the_features_do_not_change_when_the_scene_is_turned():
    worlds = vector(REACH[2], 2, observation="features")
    worlds.reset(seed=[4, 4])
    task, turn = worlds.task, 0.7
    task.simulation.array("qpos")[1, 0] += turn
    cos, sin = np.cos(turn), np.sin(turn)
    rotation = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    task._targets[1] = rotation @ task._targets[1]
    boxes = task._boxes[1]
    present = (boxes[:, 3:6] > 0).all(axis=1)
    boxes[present, :3] = boxes[present, :3] @ rotation.T
    boxes[present, 6] += turn
    task.simulation.refresh()
    task._update_state(np.zeros((2, 6)))
    seen = task.observe()
    np.testing.assert_allclose(seen[0], seen[1], atol=1e-5)


def test_own_learners_features_are_the_environments():
    torch = pytest.importorskip("torch")
    from armctl.rl.networks.features import BaseYawInvariantFeatures

    paper, features = vector(REACH[0], 16), vector(REACH[0], 16, observation="features")
    rng = np.random.default_rng(0)
    for made in (paper, features):
        made.reset(seed=9)
    own = BaseYawInvariantFeatures(paper.single_observation_space, 6, {})
    for _ in range(5):
        actions = rng.uniform(-np.pi, np.pi, (16, 6))
        seen = own(torch.as_tensor(paper.step(actions)[0])).numpy()
        np.testing.assert_allclose(seen, features.step(actions)[0], atol=1e-5)


def test_a_joint_that_is_told_to_stay_moves_on_and_the_default_observation_hides_why():
    worlds = vector(REACH[0], 1, observation="full")
    worlds.reset(seed=0)
    goal = worlds.task.robot.home.copy()
    goal[0] += 3
    while (seen := worlds.step(goal[None])[0])[0, 12] < 2.4:
        pass
    stay = goal.copy()
    stay[0] = seen[0, 3]
    assert worlds.step(stay[None])[0][0, 3] - stay[0] == pytest.approx(0.083, abs=0.01)


@pytest.mark.parametrize("camera", ["depth", "classes"])
def test_images_of_whole_numbers_show_the_same_as_floats(camera):
    plain, whole = (
        vector(BRIDGE[0], 2, camera=camera, resolution=(16, 12), image_format=form) for form in ("float", "uint8")
    )
    seen, shown = (made.reset(seed=2)[0]["image"] for made in (plain, whole))
    assert shown.shape == (2, 12, 16, 1)
    assert shown.dtype == np.uint8
    highest = 10.0 if camera == "depth" else plain.single_observation_space["image"].high.max()
    np.testing.assert_allclose(shown[..., 0] / 255, seen / highest, atol=0.5 / 255 + 1e-6)


def test_nearness_is_one_half_at_half_a_metre():
    plain, near = (vector(BRIDGE[0], 2, observation=name, **SMALL) for name in ("paper", "features"))
    depths, nearness = (made.reset(seed=2)[0]["image"] for made in (plain, near))
    np.testing.assert_allclose(nearness, 0.5 / (0.5 + depths), rtol=1e-6)


def test_convolutional_networks_take_the_default_image():
    made = vector(BRIDGE[0], 1, image_format="uint8")
    assert min(made.single_observation_space["image"].shape[:2]) >= 36

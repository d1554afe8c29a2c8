"""Environments of others: the same protocol, exact episodes, and errors that name whose they are."""

from pathlib import Path

import gymnasium
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError, EnvironmentFailed, InvalidAction
from armctl.envs import episode_seed, find_spec, full_id, make_worlds
from armctl.rollout.seeding import SeedCheck, check_seed

ODD = str(Path(__file__).with_name("odd_environments.py"))
IDS = ["Pendulum-v1", "Reacher-v5", "CartPole-v1", "FrozenLake-v1", "Blackjack-v1", f"{ODD}:Rich", f"{ODD}:Mixed"]


def play(worlds, seed, episodes, steps=15):
    """Observations and rewards of some episodes with the same random actions."""
    worlds.single_action_space.seed(5)
    seen = [worlds.reset(seed=[seed] * worlds.num_envs, options={"episode": episodes})[0]]
    rewards = []
    for _ in range(steps):
        action = worlds.single_action_space.sample()
        observations, reward, *_ = worlds.step([action] * worlds.num_envs)
        seen.append(observations)
        rewards.append(reward)
    return seen, np.array(rewards)


@pytest.mark.parametrize("env", IDS)
def test_an_episode_is_what_the_environment_itself_plays(env):
    worlds = make_worlds(env, 2)
    seen, rewards = play(worlds, 7, [0, 3])
    single = gymnasium.make(find_spec(env), disable_env_checker=True)
    for i, episode in enumerate((0, 3)):
        worlds.single_action_space.seed(5)
        observation, _ = single.reset(seed=episode_seed(7, episode))
        ended = False
        for step in range(len(seen)):
            ours = {k: v[i] for k, v in seen[step].items()} if isinstance(seen[step], dict) else seen[step][i]
            np.testing.assert_equal(ours, observation)
            if step == len(rewards):
                break
            action = worlds.single_action_space.sample()
            if not ended:
                observation, reward, terminated, truncated, _ = single.step(action)
                assert rewards[step, i] == reward
                ended = terminated or truncated
            else:
                assert rewards[step, i] == 0


def test_an_episode_depends_on_seed_and_number_alone():
    one = play(make_worlds("Reacher-v5", 1), 4, [6])
    many = play(make_worlds("Reacher-v5", 3), 4, [0, 6, 1])
    assert all((a[0] == b[1]).all() for a, b in zip(one[0], many[0], strict=True))
    assert len({episode_seed(s, k) for s in range(30) for k in range(30)}) == 900


class Strict(gymnasium.Env):
    """Hands its seed to a C library, which takes positive numbers of 32 bits with a sign."""

    observation_space, action_space = gymnasium.spaces.Box(-1, 1, (1,)), gymnasium.spaces.Box(-1, 1, (1,))

    def reset(self, *, seed=None, options=None):
        if seed is not None and (type(seed) is not int or not 0 <= seed < 2**31):
            raise ValueError(f"the seed {seed!r}")
        return np.zeros(1, np.float32), {}

    def step(self, action):
        return np.zeros(1, np.float32), 0.0, False, False, {}


@pytest.mark.parametrize("seed", [0, 1, 2026, 2**31, 2**32, 2**62, 10**8, 2**63 - 1])
def test_seeds_of_others_have_31_bits(seed, monkeypatch):
    spec = gymnasium.envs.registration.EnvSpec("test/Strict-v0", entry_point=f"{__name__}:Strict", max_episode_steps=5)
    monkeypatch.setitem(gymnasium.registry, "test/Strict-v0", spec)
    worlds = make_worlds("test/Strict-v0", 64)
    worlds.reset(seed=[seed] * 64, options={"episode": [*range(63), 2**40]})


def test_single_worlds_are_reset():
    worlds = make_worlds("Pendulum-v1", 2)
    before, _ = worlds.reset(seed=[0, 0], options={"episode": [0, 1]})
    after, _ = worlds.reset(options={"reset_mask": np.array([False, True]), "episode": [9, 9]})
    assert (before[0] == after[0]).all()
    assert (before[1] != after[1]).any()
    assert worlds.episodes.tolist() == [0, 9]


@pytest.mark.parametrize(
    ("name", "full"),
    [
        ("ArmReach-v0", "armctl/ArmReach-v0"),
        ("armctl/ArmReach-v0", "armctl/ArmReach-v0"),
        ("Pendulum-v1", "Pendulum-v1"),
        (f"{ODD}:Line-v0", f"{ODD}:odd/Line-v0"),
        (f"{ODD}:odd/Line-v0", f"{ODD}:odd/Line-v0"),
        (f"{ODD}:Line", f"{ODD}:Line"),
        (f"{ODD}:line_of", f"{ODD}:line_of"),
    ],
)
def test_names_are_understood(name, full):
    assert full_id(name) == full_id(full) == full
    make_worlds(name, 1).close()


@pytest.mark.parametrize(
    ("env", "options", "said"),
    [
        ("Pendulun-v1", {}, "Did you mean 'Pendulum-v1'"),
        ("ArmReech-v0", {}, "Did you mean 'ArmReach-v0'"),
        ("Pendulum-v1", {"gravity": 5}, "no option of Pendulum-v1 'gravity'. .* g, max_episode_steps"),
        ("Pendulum-v1", {"g": "much"}, None),
        ("LunarLander-v3", {}, "could not be made: DependencyNotInstalled"),
        ("nowhere:Line-v0", {}, "No module named 'nowhere'"),
        ("nowhere.py:Line-v0", {}, "there is no file .*nowhere.py"),
        (
            f"{ODD}:Lime",
            {},
            "no environment '.*:Lime'. Did you mean 'Line'.* In odd_environments there are: Line, Silent",
        ),
        (f"{ODD}:NoSpaces", {}, r"NoSpaces has no observation_space \(odd_environments.py:\d+\)"),
        ("odd_environments.py", {}, "odd_environments.py:NAME"),
        (f"{ODD}:Broken", {}, r"no licence \(odd_environments.py:\d+\)"),
        ("Pendulum-v1", {"render_mode": "human"}, "cannot be set as an option"),
        ("Pendulum-v1", {"disturbances": {"payload": 3}}, "no disturbance here 'payload'.*delay, noise"),
        ("CartPole-v1", {"disturbances": {"delay": 3}}, "no disturbance here 'delay'"),
    ],
)
def test_mistakes_are_named(env, options, said):
    if said is None:
        make_worlds(env, 1, options).close()  # the environment's own business
        return
    with pytest.raises(ConfigurationError, match=said):
        make_worlds(env, 1, options)


@pytest.mark.parametrize(
    ("env", "actions", "said"),
    [
        ("Pendulum-v1", [[0.0, 1.0]], "shape"),
        ("Pendulum-v1", [0.0], "shape"),
        ("Pendulum-v1", [[np.nan]], "not finite"),
        ("Pendulum-v1", [["left"]], "array of numbers"),
        ("CartPole-v1", [2], "not 1 of Discrete"),
        ("CartPole-v1", [0.5], "not 1 of Discrete"),
        ("CartPole-v1", [0, 1], "not 1 of Discrete"),
        ("CartPole-v1", [[0, 1]], "not 1 of Discrete"),
        (f"{ODD}:Mixed", [(5, [0.0])], "not 1 of Tuple"),
        (f"{ODD}:Rich", [[5, 0]], "not 1 of MultiDiscrete"),
    ],
)
def test_invalid_actions_step_nothing(env, actions, said):
    worlds = make_worlds(env, 1)
    worlds.reset(seed=0)
    with pytest.raises(InvalidAction, match=said):
        worlds.step(actions)
    assert worlds._steps[0] == 0


def test_failures_name_the_environment_and_the_place():
    worlds = make_worlds(f"{ODD}:Crashing", 1)
    worlds.reset(seed=0)
    with pytest.raises(EnvironmentFailed, match=r"Crashing failed in episode 0: .*distanec.* \(odd_envir\w+.py:\d+"):
        worlds.step([[0.0]])
    worlds = make_worlds(f"{ODD}:Nan", 1)
    worlds.reset(seed=0)
    worlds.step([[0.0]])
    worlds.step([[0.0]])
    with pytest.raises(EnvironmentFailed, match="Nan returned the reward nan in step 3 of episode 0"):
        worlds.step([[0.0]])


def test_a_reward_is_one_number():
    worlds = make_worlds(f"{ODD}:Paired", 1)
    worlds.reset(seed=0)
    with pytest.raises(EnvironmentFailed, match=r"the reward is array\(\[1., 2.\]\), not a number"):
        worlds.step([[0.0]])


def test_a_class_or_a_function_is_an_environment_too():
    from armctl.core.registration import import_named

    module = import_named(ODD, "the test")
    assert full_id(module.Line) == f"{module.__name__}:Line"
    make_worlds(module.line_of, 1).close()
    for given in (module.Line(), lambda: module.Line(), 3):
        with pytest.raises(ConfigurationError, match=r"an environment is an id, .* gymnasium.register"):
            full_id(given)


def test_an_endless_episode_is_noticed():
    worlds = make_worlds(f"{ODD}:Endless", 1)
    worlds.reset(seed=0)
    worlds._steps[:] = 99_998
    worlds.step([[0.0]])
    with pytest.raises(EnvironmentFailed, match="max_episode_steps"):
        worlds.step([[0.0]])
    limited = make_worlds(f"{ODD}:Endless", 1, {"max_episode_steps": 3})
    limited.reset(seed=0)
    assert [bool(limited.step([[0.0]])[3][0]) for _ in range(3)] == [False, False, True]


@pytest.mark.parametrize(("name", "told"), [("Line", True), ("Silent", None), ("Winning", True)])
def test_success_is_what_the_last_info_says(name, told):
    worlds = make_worlds(f"{ODD}:{name}", 2)
    worlds.reset(seed=[0, 0], options={"episode": [0, 1]})
    ended = {}
    while len(ended) < 2:
        _, _, terminated, truncated, infos = worlds.step([[0.2], [-0.2]])
        for i in np.flatnonzero(terminated | truncated):
            ended[int(i)] = infos["is_success"][i], worlds.outcomes[infos["outcome_id"][i]]
    assert ended[0] == (told, "success" if told else "terminated")
    assert ended[1] == (False if name == "Line" else None, "truncated")


def test_success_by_return():
    outcomes = []
    for bound in (-1e9, 1e9):
        worlds = make_worlds("Pendulum-v1", 1, {"success_return": bound, "max_episode_steps": 1})
        worlds.reset(seed=0)
        outcomes.append(worlds.step([[0.0]])[4]["is_success"][0])
    assert outcomes == [True, False]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Line", []),
        ("Rich", []),
        ("Deaf", ["does not obey its seed: episode 0 differs from its start"]),
        ("DeafLater", ["does not obey its seed: episode 0 differs in step 4"]),
        ("Remembering", ["does not obey its seed: episode 0 differs from its start"]),
        ("Monotonous", ["plays the same episode whatever its seed"]),
        ("Mixed", []),
        ("Misfit", ["declares observations of shape (1,), and observes (2,)"]),
        ("Blind", ["observes numbers that are not finite"]),
        ("Crashing", ["Whether Crashing obeys its seed is unknown"]),
    ],
)
def test_an_environment_that_ignores_its_seed_is_found_out(name, said):
    found = check_seed(f"{ODD}:{name}")
    notes = found.notes
    assert found.obeyed != any("does not obey" in note for note in notes)
    assert len(notes) == len(said)
    assert all(expected in note for expected, note in zip(said, notes, strict=True))


@pytest.mark.parametrize("env", ["armctl/ArmReach-v0", "armctl/BridgeCrossMoving-v0", "Reacher-v5", "HalfCheetah-v5"])
def test_good_environments_obey_their_seeds(env):
    assert check_seed(env) == SeedCheck([])


def test_disturbances_reach_the_policy_and_the_world():
    quiet, noisy = (make_worlds("Pendulum-v1", 2, options) for options in ({}, {"disturbances": {"noise": 0.1}}))
    (seen, rewards), (disturbed, same) = (play(worlds, 3, [0, 1]) for worlds in (quiet, noisy))
    assert (np.array(seen) != np.array(disturbed)).any()
    assert (rewards == same).all()
    late = make_worlds("Pendulum-v1", 1, {"disturbances": {"delay": 2}})
    _, delayed = play(late, 3, [0])
    assert (delayed[:, 0] != rewards[:, 0]).any()


def test_training_in_them_is_refused():
    with pytest.raises(ConfigurationError, match="armctl export"):
        make_worlds("Pendulum-v1", 2, autoreset_mode="same_step")

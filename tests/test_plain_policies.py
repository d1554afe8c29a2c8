"""Plain Python as policies: functions, classes, objects and models, of one world's observation."""

import pickle
import re

import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.policies import Policy, make_policy
from armctl.rollout import rollouts

PENDULUM = "Pendulum-v1"
FILE = """
import numpy as np


def pd(observation):
    x, y, speed = observation
    return [-10 * np.arctan2(y, x) - 2 * speed]


class Controller:
    def __init__(self, env):
        self.space = env.action_space

    def act(self, observation):
        return np.clip(pd(observation), self.space.low, self.space.high)


class Counting:
    made = 0

    def __init__(self):
        Counting.made += 1
        self.steps = 0

    def reset(self):
        self.steps = 0

    def act(self, observation):
        self.steps += 1
        return [2.0 * (-1) ** self.steps]


def made_of(env):
    return Controller(env.in_world(0))


def made_of_nothing():
    return Counting()


sleeping = Counting()


def two(observation):
    return [0.0, 0.0]


def nothing(observation):
    pass


def typo(observation):
    return obsevation[:1]


class Dumb:
    pass


def makes_a_number(env):
    return 3


def fails(env):
    raise OSError("no licence")


number = 3
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("own") / "own_policies.py"
    path.write_text(FILE)
    return path


def returns(policy, env=PENDULUM, worlds=1, episodes=4):
    made_env = make_worlds(env, worlds)
    made = make_policy(policy, made_env)
    assert isinstance(made, Policy)
    played = {result.episode: result.total_reward for result in rollouts(made, made_env, episodes, 0)}
    return [played[episode] for episode in range(episodes)]


@pytest.mark.one_case
@pytest.mark.parametrize("name", ["pd", "Controller", "Counting", "made_of", "made_of_nothing", "sleeping"])
def test_each_form_plays_alike_in_one_world_and_in_many(file, name):
    one = returns(f"{file}:{name}")
    assert one == returns(f"{file}:{name}", worlds=3)
    assert len(set(one)) == 4


def test_a_file_is_imported_once_and_its_folder_is_known(file, tmp_path, monkeypatch):
    (tmp_path / "helper_of_mine.py").write_text("GAIN = 3.0\n")
    (tmp_path / "json.py").write_text("from helper_of_mine import GAIN\n\n\ndef act(observation):\n    return [GAIN]\n")
    monkeypatch.chdir(tmp_path)
    assert returns("json.py:act") == returns(str(tmp_path / "json.py") + ":act")
    import json

    assert json.loads("1") == 1  # the standard library's is still what it was


@pytest.mark.slow
def test_functions_and_classes_can_be_given_as_they_are():
    class Constant:
        sees = "state"
        training_steps = 7

        def act(self, observation):
            return np.zeros(1)

    def pd(observation):
        return [-10 * np.arctan2(observation[1], observation[0]) - 2 * observation[2]]

    comparison = armctl.compare([pd, Constant, "random"], PENDULUM, episodes=12)
    assert [policy.policy for policy in comparison.policies] == ["pd", "Constant", "random"]
    assert [policy.sees for policy in comparison.policies] == ["observation", "state", "observation"]
    assert comparison.policies[1].training.decisions == 7
    named = armctl.compare({"strong": pd, "weak": lambda observation: [0.0]}, PENDULUM, episodes=3)
    assert [policy.policy for policy in named.policies] == ["strong", "weak"]


def test_a_function_acts_in_armctls_own_environments():
    def still(observation):
        return observation[3:9]

    class Still:
        sees = "model"

        def __init__(self, env):
            assert env.observation_space.shape == (12,)
            assert env.robot.dof == 6

        def act(self, observation):
            return observation[3:9]

    assert returns(still, "ArmReach-v0", episodes=2) == returns(Still, "ArmReach-v0", worlds=2, episodes=2)


def test_a_class_that_sees_the_state_knows_which_world_is_its_own():
    @armctl.sees("state", foresight="simulator")
    class Knowing:
        def __init__(self, env):
            assert env.unwrapped is env
            self.env, self.model = env, env.model()

        def act(self, observation):
            env = self.env
            place = env.task.state.end_effector_position[env.world]
            np.testing.assert_allclose(observation[:3], place, atol=1e-6)
            np.testing.assert_allclose(env.perceived().state.joint_positions[env.world], observation[3:9], atol=1e-6)
            self.steps = env.control_step()
            return env.idle_action + 0.01 * (1 + env.world)

    comparison = armctl.compare([Knowing], "ArmReach-v0", episodes=3, worlds=3, env_options={"max_episode_steps": 3})
    assert not comparison.failures
    assert set(comparison.results.column("outcome")) == {"timeout"}


def test_discrete_actions():
    assert returns(lambda observation: int(observation[2] > 0), "CartPole-v1") == returns(
        lambda observation: np.int64(observation[2] > 0), "CartPole-v1", worlds=2
    )


class Model:
    """With the `predict` of Stable-Baselines3's recurrent models: it acts by how long an episode has lasted."""

    num_timesteps = 123

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        assert deterministic
        assert len(observation) == len(episode_start)
        lasted = np.where(episode_start, 0, 0 if state is None else state)
        return (lasted % 3 - 1.0)[:, None], lasted + 1


def test_models_with_memory_forget_when_an_episode_begins():
    one = returns(Model())
    assert one == returns(Model(), worlds=3)
    assert make_policy(Model(), make_worlds(PENDULUM, 1)).training_steps == 123


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Dumb", r"is a class without act\(observation\) \(own_policies.py:\d+\)"),
        ("makes_a_number", r"made something of type int, which is not a policy: .* \(own_policies.py:\d+\)"),
        ("fails", r"could not be made: OSError: no licence \(own_policies.py:\d+\)"),
        ("number", "is of type int, which cannot be called"),
        ("pdd", "Did you mean 'pd'"),
    ],
)
def test_what_is_no_policy_is_refused(file, name, said):
    with pytest.raises(ConfigurationError, match=said):
        make_policy(f"{file}:{name}", make_worlds(PENDULUM, 1))


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("two", r"it returned an action of shape \(2,\); expected are numbers of shape \(1,\) \(own_policies.py:\d+\)"),
        ("nothing", r"it returned None; .* \(own_policies.py:\d+\)"),
        ("typo", r"NameError: name 'obsevation' is not defined \(own_policies.py:\d+\)"),
    ],
)
def test_a_policy_that_fails_is_shown_with_its_place(file, name, said):
    comparison = armctl.compare([f"{file}:{name}", "random"], PENDULUM, episodes=2)
    assert list(comparison.failures) == [f"{file}:{name}"]
    assert re.search(said, comparison.failures[f"{file}:{name}"])
    assert "Traceback" in comparison.tracebacks[f"{file}:{name}"]
    assert len(comparison.episodes) == 2


@pytest.mark.parametrize("text", ["import nothing_there", "def broken(:", "raise KeyboardInterrupt and 1 / 0"])
def test_a_file_that_cannot_be_imported(tmp_path, text):
    (tmp_path / "broken_file.py").write_text(text)
    with pytest.raises((ConfigurationError, TypeError), match=r"broken_file|nothing_there|exceptions must"):
        make_policy(f"{tmp_path}/broken_file.py:policy", make_worlds(PENDULUM, 1))


def test_a_models_file_is_not_opened(tmp_path):
    (tmp_path / "model.zip").write_bytes(pickle.dumps(print))
    with pytest.raises(ConfigurationError, match="armctl export"):
        make_policy(str(tmp_path / "model.zip"), make_worlds(PENDULUM, 1))


@pytest.mark.parametrize("name", ["reach_ik", "bridge_ompl", "reach_ppo"])
def test_experts_say_where_they_belong(name):
    with pytest.raises(Exception, match="armctl/"):
        make_policy(name, make_worlds(PENDULUM, 1))


def test_failures_show_where_a_comparison_does():
    comparison = armctl.compare([lambda observation: None, "random"], PENDULUM, episodes=2)
    assert "it returned None" in repr(comparison)
    assert "it returned None" in comparison._repr_html_()

"""What environments of others return is checked where it comes in: usable values go on, others are told in a line."""

import decimal
import fractions
import itertools
import warnings
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st

from armctl.core.errors import ConfigurationError, EnvironmentFailed, ResultsError
from armctl.datasets.collect import collect
from armctl.envs import foreign_values, make_worlds
from armctl.rollout.loop import evaluate
from armctl.study import compare

from ..command_line import program


class Walk(gymnasium.Env):
    """Three steps on a line; what it returns is changed by the subclasses."""

    observation_space: spaces.Space = spaces.Box(-9, 9, (1,), np.float32)
    action_space = spaces.Box(-1, 1, (1,))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = 0
        return self.observe(), {}

    def step(self, action):
        self.t += 1
        return self.observe(), self.reward(), False, self.t >= 3, self.info()

    def observe(self):
        return np.zeros(1, np.float32)

    def reward(self):
        return -1.0

    def info(self):
        return {}


NUMBERS = itertools.count()


def changed(**methods):
    """The id of an environment with other methods."""
    name = f"Changed{next(NUMBERS)}-v0"
    gymnasium.register(name, entry_point=lambda **options: type("Changed", (Walk,), methods)())
    return name


def still(observation):
    return [0.0]


def returns(env, **options):
    return evaluate(still, env, episodes=2, **options)["return"].tolist()


@pytest.mark.parametrize(
    "value",
    [2, 2.0, np.float16(2), np.int8(2), np.array(2.0), np.array([2]), [2.0], fractions.Fraction(2), decimal.Decimal(2)],
)  # fmt: skip
def test_numbers_of_every_kind_are_rewards(value):
    with warnings.catch_warnings(action="error", category=DeprecationWarning):
        assert returns(changed(reward=lambda env: value)) == [6.0, 6.0]


@pytest.mark.parametrize("value", [None, "1", b"1", 1j, np.complex64(1), [1.0, 2.0], {}, np.array([]), object()])
def test_nothing_else_is_a_reward(value):
    with pytest.raises(EnvironmentFailed, match=r"failed in episode 0: the reward is .*, not a number"):
        returns(changed(reward=lambda env: value))


@given(
    st.one_of(
        st.none(), st.booleans(), st.floats(), st.integers(), st.text(), st.complex_numbers(), st.lists(st.floats())
    )
)
def test_a_value_is_a_number_or_an_error(value):
    try:
        number = foreign_values.number(value, "it")
    except EnvironmentFailed:
        assert not isinstance(value, (bool, int, float))
    else:
        assert isinstance(number, float)


@pytest.mark.parametrize(
    ("value", "success"),
    [
        (True, True), (np.bool_(False), False), (1, True), (0.0, False), (np.array([True]), True), ([1], True),
        (np.nan, None), ("False", None), (0.3, None), ({"arm": False}, None), (np.array([True, False]), None),
        ([], None),
    ],
)  # fmt: skip
@pytest.mark.parametrize("key", ["success", "is_success"])
def test_success_is_what_is_true_or_false(value, success, key):
    env = changed(info=lambda env: {key: value})
    comparison = compare({"still": still}, env, episodes=2)
    assert [result.success for result in comparison.results] == [success, success]
    assert any("neither true nor false" in note for note in comparison.notes) == (success is None)


EARLY = """
import gymnasium
import numpy as np
from gymnasium import spaces

class Early(gymnasium.Env):
    observation_space = action_space = spaces.Box(-1, 1, (1,))
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.t = 0
        return np.zeros(1), {}
    def step(self, action):
        self.t += 1
        return np.zeros(1), 0.0, False, self.t == 3, {"success": self.t == 2}
"""


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_success_before_the_last_step_is_told(workers, tmp_path):
    file = tmp_path / "early.py"
    file.write_text(EARLY)
    comparison = compare({"still": still}, f"{file}:Early", episodes=4, workers=workers)
    assert [result.success for result in comparison.results] == [False] * 4
    assert any("an earlier step tells of a success" in note for note in comparison.notes)
    comparison = compare({"still": still}, f"{file}:Early", episodes=4, env_options={"success": "any"}, workers=workers)
    assert [result.success for result in comparison.results] == [True] * 4
    assert not any("an earlier step" in note for note in comparison.notes)


@pytest.mark.parametrize(
    ("methods", "says"),
    [
        (
            {"step": lambda env, action: (0, 0.0, True, {})},
            r"Changed.step returned 4 values, not 5: observation, reward",
        ),
        ({"step": lambda env, action: None}, "Changed.step returned a NoneType, not 5"),
        ({"reset": lambda env, *, seed=None, options=None: np.zeros(1)}, "Changed.reset returned a ndarray, not 2"),
        ({"info": lambda env: None}, "info is None, not a dict"),
        ({"observe": lambda env: ["a"]}, "its observation is a list, and its space has numbers"),
        ({"observe": lambda env: None}, "its observation is None"),
        ({"info": lambda env: {"reward_terms": {"far": None}}}, "the reward term far is None, not a number"),
        ({"info": lambda env: {"reward_terms": {"far": np.zeros(2)}}}, "the reward term far is array"),
        ({"info": lambda env: {"reward_terms": {"far": np.inf}}}, "the reward term far is inf"),
        (
            {"step": lambda env, action: (np.zeros(1), 0.0, None, True, {})},
            "terminated is None, neither true nor false",
        ),
    ],
)
def test_what_cannot_be_used_is_told_in_a_line(methods, says):
    with pytest.raises(EnvironmentFailed, match=says) as told:
        returns(changed(**methods))
    assert len(str(told.value).splitlines()) == 1


def secret(env):
    raise RuntimeError("not for you")


@pytest.mark.parametrize("model", [property(secret), "a text", None])
def test_what_is_no_model_of_mujoco_is_no_simulator_to_foresee(model):
    assert make_worlds(changed(model=model), 1).foresight == ()


def test_an_environment_without_seeds_is_refused():
    with pytest.raises(ConfigurationError, match=r"Changed.reset takes no seed"):
        returns(changed(reset=lambda env: (np.zeros(1), {})))


NESTED = spaces.Dict(cart=spaces.Dict(x=spaces.Box(-9, 9, (1,)), mode=spaces.Discrete(3)), goal=spaces.Box(-9, 9, (2,)))


@pytest.mark.parametrize("worlds", [1, 3])
@pytest.mark.parametrize(
    ("space", "observe"),
    [
        (NESTED, lambda env: {"cart": {"x": np.ones(1), "mode": 2}, "goal": np.zeros(2)}),
        (spaces.Tuple([spaces.Discrete(3), spaces.Box(-1, 1, (2,))]), lambda env: (1, np.zeros(2))),
        (spaces.Sequence(spaces.Discrete(3)), lambda env: (1,) * env.t),
        (spaces.Text(9), lambda env: "a" * env.t),
        (spaces.Box(-1, 1, (2,)), lambda env: np.zeros(2 + env.t)),
    ],
    ids=["nested", "tuple", "sequence", "text", "box of another shape"],
)
def test_a_policy_sees_one_world_s_observation_as_it_was(space, observe, worlds):
    seen = []

    def act(observation):
        seen.append(observation)
        return [0.0]

    env = changed(observation_space=space, observe=observe)
    assert evaluate(act, env, episodes=3, worlds=worlds)["return"].tolist() == [-3.0] * 3
    for t in range(3):
        assert any(_same(one, observe(SimpleNamespace(t=t))) for one in seen), t


def _same(a, b):
    if isinstance(b, dict):
        return isinstance(a, dict) and a.keys() == b.keys() and all(_same(a[name], b[name]) for name in b)
    if isinstance(b, tuple):
        return isinstance(a, tuple) and len(a) == len(b) and all(map(_same, a, b))
    return np.shape(a) == np.shape(b) and bool(np.all(np.asarray(a) == b))


def test_an_observation_is_a_copy():
    buffer = np.zeros(1)

    def observe(env):
        buffer[:] = env.t
        return buffer

    worlds = make_worlds(changed(observe=observe), 1)
    first, _ = worlds.reset(seed=0)
    worlds.step([[0.0]])
    assert first[0, 0] == 0


BOXES = spaces.Dict(depth=spaces.Box(0, np.inf, (4,), np.float32), at=spaces.Box(-9, 9, (2,), np.float32))


@pytest.mark.one_case
@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf, 0.0])
def test_observations_that_are_not_finite_reach_policies_with_a_remark_and_no_dataset(number, tmp_path):
    def observe(env):
        return {"depth": np.array([1, number, 0, 2], np.float32), "at": np.zeros(2, np.float32)}

    env, is_finite = changed(observation_space=BOXES, observe=observe), bool(np.isfinite(number))
    seen = []

    def act(observation):
        seen.append(observation["depth"][1])
        return [0.0]

    notes = compare({"act": act}, env, episodes=2).notes
    assert np.array_equal(seen[0], np.float32(number), equal_nan=True)
    assert sum("are not finite (NaN or infinite)" in note for note in notes) == (not is_finite)
    for table_format in ("minari", "lerobot"):
        out = tmp_path / table_format
        if is_finite:
            assert collect(act, env, episodes=2, out=out, format=table_format).episodes == 2
            continue
        with pytest.raises(ResultsError, match=r"observations/depth of episode 0 has numbers that are not finite"):
            collect(act, env, episodes=2, out=out, format=table_format)


@pytest.mark.parametrize(
    "frame",
    [None, [np.zeros((4, 4, 3), np.uint8)], np.zeros((4, 4)), *(np.zeros(s, np.uint8) for s in [(4, 4, 2), (0, 4, 3)])],
)  # fmt: skip
def test_what_is_no_picture_is_told(frame):
    with pytest.raises(EnvironmentFailed, match=r"render returned .*, not an array \(height, width, 3\) of uint8"):
        foreign_values.picture(frame, Walk())


def test_transparency_is_left_out():
    assert foreign_values.picture(np.zeros((4, 5, 4), np.uint8), Walk()).shape == (4, 5, 3)


CHATTY = """
import ctypes, os
import gymnasium
import numpy as np
from gymnasium import spaces

class Chatty(gymnasium.Env):
    observation_space = spaces.Box(-1, 1, (1,))
    action_space = spaces.Box(-1, 1, (1,))
    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        print("hello from Python")
        ctypes.CDLL(None).printf(b"hello from C\\n")
        os.write(1, b"hello from the descriptor\\n")
        return np.zeros(1), {}
    def step(self, action):
        return np.zeros(1), 0.0, False, True, {}
    def close(self):
        raise RuntimeError("close fails")

def still(observation):
    return [0.0]
"""


@pytest.mark.slow
@pytest.mark.parametrize("table_format", ["json", "csv", "markdown"])
def test_standard_output_holds_the_document_only(table_format, tmp_path):
    (tmp_path / "chatty.py").write_text(CHATTY)
    about = ["--env", "chatty.py:Chatty", "--episodes", 2, "--out", "results", "--format", table_format]
    done = program("compare", "chatty.py:still", "random", *about, cwd=tmp_path)
    assert "hello" not in done.stdout
    assert done.stdout.startswith({"json": "{", "csv": "table,policy", "markdown": "**"}[table_format])
    for who in ("Python", "C", "the descriptor"):
        assert f"hello from {who}" in done.stderr
    assert "could not be closed" in done.stderr

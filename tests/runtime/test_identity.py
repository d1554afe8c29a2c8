"""What makes a comparison another one: the values that a policy or an environment is made of."""

import functools
import threading

import numpy as np
import pytest
import torch

from armctl.core.errors import ResultsError
from armctl.runtime import identity as identity_module
from armctl.runtime.fingerprint import fingerprint
from armctl.runtime.folder import differences
from armctl.runtime.provenance import versions
from armctl.study import compare
from armctl.study.results import read_comparison

from .resuming import OPTIONS, plays


class Gain:
    def __init__(self, gain):
        self.gain = gain

    def act(self, observation):
        return observation[3:9] * self.gain


def closure(gain):
    def act(observation):
        return observation[3:9] * gain

    return act


def default(gain):
    def act(observation, gain=gain):
        return observation[3:9] * gain

    return act


def of_a_class(gain):
    class Local:
        factor = gain

        def act(self, observation):
            return observation[3:9] * self.factor

    return Local


def of_a_property(gain):
    class Local:
        factor = property(lambda self: gain)

        def act(self, observation):
            return observation[3:9] * self.factor

    return Local()


def nested(gain):
    inner = closure(gain)
    return lambda observation: inner(observation)


KINDS = {
    "object": Gain, "closure": closure, "default": default, "class": of_a_class, "property": of_a_property,
    "bound method": lambda gain: Gain(gain).act,
    "partial of a lambda": lambda gain: functools.partial(lambda factor, observation: observation[3:9] * factor, gain),
    "nested": nested, "object with a function inside": lambda gain: Gain(closure(gain)),
    "array": lambda gain: np.full(5000, gain), "set": lambda gain: {"a", "b", str(gain)},
    "frozen": lambda gain: frozenset({"a", str(gain)}),
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_another_value_inside_is_another_object(kind):
    make = KINDS[kind]
    assert fingerprint(make(0.1)) == fingerprint(make(0.1))
    assert fingerprint(make(0.1)) != fingerprint(make(0.9))
    assert "unknown" not in fingerprint(make(0.1))


def test_what_cannot_be_hashed_is_played_and_written_but_not_resumed(tmp_path):
    """Whoever asks for it is told which of the policies it is, and which part of it."""
    policies = {"locked": Gain(0.1), "mine": Gain(0.1)}
    policies["locked"].lock = threading.Lock()  # type: ignore[attr-defined]
    first = compare(policies, episodes=2, out=tmp_path, env_options=OPTIONS)
    assert len(first.results) == 4
    assert read_comparison(tmp_path).names == ["locked", "mine"]
    with pytest.raises(ResultsError) as refused:
        compare(policies, episodes=2, out=tmp_path, env_options=OPTIONS)
    assert "episodes of locked cannot be resumed, since it cannot be hashed (its .lock of type lock: " in str(
        refused.value
    )
    assert "use a module:function" in str(refused.value)
    assert "--overwrite" in str(refused.value)
    assert "mine" not in str(refused.value)
    assert compare(policies, episodes=2, out=tmp_path, env_options=OPTIONS, overwrite=True).resumed == 0


@pytest.mark.one_case
@pytest.mark.parametrize("kind", ["object", "closure", "default", "class", "bound method"])
def test_another_policy_of_the_same_name_does_not_resume(tmp_path, kind):
    make = KINDS[kind]
    compare({"mine": make(0.1)}, episodes=2, out=tmp_path, env_options=OPTIONS)
    assert compare({"mine": make(0.1)}, episodes=2, out=tmp_path, env_options=OPTIONS).resumed == 2
    with pytest.raises(ResultsError, match="objects: mine"):
        compare({"mine": make(0.9)}, episodes=2, out=tmp_path, env_options=OPTIONS)


def test_options_that_are_objects_count_by_value(tmp_path):
    def reward(scale):
        return {"max_episode_steps": 3, "reward": {"near": lambda state: scale * state.distance}}

    compare("random", episodes=2, out=tmp_path, env_options=reward(1.0))
    assert compare("random", episodes=2, out=tmp_path, env_options=reward(1.0)).resumed == 2
    with pytest.raises(ResultsError, match="env_options: reward"):
        compare("random", episodes=2, out=tmp_path, env_options=reward(2.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    "place",
    ["armctl.tasks.reach.reach:ReachTask.instruction", "armctl.tasks.reach.reach:LARGEST_RELATIVE_MOVE"],
)
def test_a_constant_of_the_task_that_a_script_sets_is_another_task(tmp_path, monkeypatch, place):
    assert plays(tmp_path) == 0
    monkeypatch.setattr(place.replace(":", "."), 0.123)
    with pytest.raises(ResultsError, match="constants"):
        plays(tmp_path)


class Net(torch.nn.Module):
    def __init__(self, gain):
        super().__init__()
        self.linear, self.gain = torch.nn.Linear(1, 1), gain
        torch.nn.init.zeros_(self.linear.weight)
        torch.nn.init.zeros_(self.linear.bias)

    def act(self, observation):
        return observation[3:9] * self.gain


class Doubled(Net):
    def act(self, observation):
        return 2 * super().act(observation)


@pytest.mark.slow
@pytest.mark.parametrize("other", [lambda: Net(0.9), lambda: Doubled(0.1)], ids=["attribute", "type"])
def test_a_torch_module_with_the_same_parameters_is_another_one(tmp_path, other):
    assert plays(tmp_path, {"net": Net(0.1)}) == 0
    assert plays(tmp_path, {"net": Net(0.1)}) == 2
    with pytest.raises(ResultsError, match="objects: net"):
        plays(tmp_path, {"net": other()})


@pytest.mark.one_case
@pytest.mark.parametrize("package", ["numba", "llvmlite", "coal", "torch"])
def test_another_version_of_what_computes_does_not_resume(tmp_path, monkeypatch, package):
    assert plays(tmp_path) == 0
    real = versions()
    assert package in real
    monkeypatch.setattr(identity_module, "versions", lambda: real | {package: "0.1"})
    with pytest.raises(ResultsError, match=f"versions: {package} "):
        plays(tmp_path)


def test_differences_are_told_one_by_one():
    assert differences({"a": 1, "b": {"x": 1, "y": 2}}, {"a": 1, "b": {"x": 1, "z": 3}}) == [
        "b: y 2 there, None here",
        "b: z None there, 3 here",
    ]

"""Interfaces that policies declare: each plays with its own, whoever it meets, and a wrong one is one clear error."""

import importlib
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.policies import WorldsByInterface, make_policy

ODD = Path(__file__).parents[1] / "envs" / "odd_environments.py"
REACH = "armctl/ArmReach-v0"
SHORT = {"max_episode_steps": 4}
MINE = """
import armctl, numpy as np

{before}@armctl.interface({interface})
class Mine:
    def __init__(self, env):
        self.facts = dict(env.interface)
        self.shape = env.observation_space.shape

    def act(self, observation):
        assert observation.shape == self.shape
        assert self.facts["control"] == "velocity"
        return 0.3 * np.sin(observation.ravel()[3:9])
"""


def mine(tmp_path, interface='control="velocity", observation="full"', before=""):
    file = tmp_path / "mine.py"
    file.write_text(MINE.format(interface=interface, before=before))
    return f"{file}:Mine"


@pytest.mark.slow
def test_policies_of_different_interfaces_meet_in_the_same_episodes(tmp_path):
    name = mine(tmp_path, 'control="velocity", observation="full", frames=2')
    comparison = armctl.compare([name, "reach_ik"], REACH, episodes=10, env_options=SHORT)
    assert not comparison.failures
    starts = {policy: rows.column("lower_bound_steps") for policy, rows in comparison.results.by_policy().items()}
    np.testing.assert_array_equal(starts[name], starts["reach_ik"])
    by_name = comparison.facts.policies
    assert by_name[name].interface == {"control": "velocity", "observation": "full", "goal": "False", "frames": "2"}
    assert by_name["reach_ik"].interface["control"] == "position"
    assert (by_name[name].sees, by_name["reach_ik"].sees) == ("observation + velocities", "model")
    sentence = (
        f"Their interfaces differ: {name} (control velocity, observation full, frames 2), "
        "reach_ik (control position, observation paper, frames 1)."
    )
    assert sentence in comparison.verdict.context
    alike = armctl.compare(["reach_ppo", "reach_ik"], REACH, episodes=10, env_options=SHORT)
    assert "interfaces" not in alike.verdict.context


@pytest.mark.slow
@pytest.mark.parametrize("how", [{"workers": 2}, {"isolate": True}, {"worlds": 3}])
def test_it_is_the_same_elsewhere(tmp_path, how):
    name = mine(tmp_path, 'control="velocity", frames=3')
    here = armctl.compare([name], REACH, episodes=4, env_options=SHORT)
    elsewhere = armctl.compare([name], REACH, episodes=4, env_options=SHORT, **how)
    assert not elsewhere.failures
    assert here.results.column("path_length").tolist() == elsewhere.results.column("path_length").tolist()


@pytest.mark.slow
def test_another_python_declares_it_without_armctl(tmp_path):
    (tmp_path / "theirs.py").write_text(
        "class Theirs:\n    interface = {'control': 'velocity', 'frames': 2}\n\n"
        "    def act(self, observation):\n        assert observation.shape == (2, 12)\n        return [0.1] * 6\n"
    )
    name = f"python={sys.executable}:{tmp_path / 'theirs.py'}:Theirs"
    comparison = armctl.compare([name, "random"], REACH, episodes=2, env_options=SHORT)
    assert not comparison.failures
    assert comparison.facts.policies[name].interface["control"] == "velocity"
    assert comparison.facts.policies[name].interface["frames"] == "2"


@pytest.mark.parametrize(
    ("interface", "message"),
    [
        ('contrl="velocity"', "no option of an interface here.*'contrl'.*Did you mean 'control'"),
        ('control="velocty"', "is made for another interface.*velocty"),
        ("frames=0", "frames are a whole number from 1 to 1000, not 0"),
        ("reward_scale=2.0", "no option of an interface here.*'reward_scale'"),
    ],
)
def test_a_wrong_interface_is_one_error(tmp_path, interface, message):
    with pytest.raises(ConfigurationError, match=message):
        armctl.compare([mine(tmp_path, interface)], REACH, episodes=1, env_options=SHORT)


def test_what_the_source_does_not_say_is_refused_once_it_is_known(tmp_path):
    name = mine(tmp_path, '**{"con" + "trol": "velocity"}')
    with pytest.raises(ConfigurationError, match="is made for control='velocity', and control is 'position' here"):
        armctl.compare([name], REACH, episodes=1, env_options=SHORT)

    @armctl.interface(control="velocity")
    def own(observation):
        return np.zeros(6)

    with closing(WorldsByInterface(REACH, 1)) as interfaces:
        make_policy(own, interfaces.of(own))
        with pytest.raises(ConfigurationError, match="is made for control='velocity'"):
            make_policy(own, interfaces.requested)

    @armctl.sees("model")
    def outer(env):
        return make_policy(own, env)

    with pytest.raises(ConfigurationError, match="is made for control='velocity'"):
        make_policy(outer, make_worlds(REACH, 1))


def test_the_interface_is_read_before_any_code_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "mine", raising=False)  # of another test
    importlib.invalidate_caches()
    mine(tmp_path, before="raise SystemExit\n")
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "__init__.py").write_text("raise SystemExit")
    (tmp_path / "package" / "inner.py").write_text("from mine_too import Mine\n")
    (tmp_path / "package" / "mine_too.py").write_text((tmp_path / "mine.py").read_text())
    with closing(WorldsByInterface(REACH, 1)) as interfaces:
        for name in ("mine.py:Mine", "mine:Mine", "package.inner:Mine", "filtered(mine.py:Mine)"):
            assert interfaces.options_of(name) == {"control": "velocity", "observation": "full"}, name
        assert interfaces.options_of("nowhere.py:Mine") == interfaces.options_of("no.where:Mine") == {}


def test_frames_are_the_last_observations():
    seen: list[Any] = []

    @armctl.interface(frames=3)
    def make(env):
        class Watching:
            sees, training_steps = "observation", 0

            def reset(self, ids):
                pass

            def act(self, observations):
                seen.append(observations)
                assert observations.shape == env.observation_space.shape
                return observations[:, -1, 3:9] + 0.1

        return Watching()

    worlds: Any = make_worlds(REACH, 2)
    policy = make_policy(make, worlds)
    observations, _ = worlds.reset(seed=0)
    policy.reset(np.arange(2, dtype=np.int32))
    shown = [observations]
    for _ in range(4):
        observations, *_ = worlds.step(policy.act(observations))
        shown.append(observations)
    np.testing.assert_array_equal(seen[0], np.stack([shown[0]] * 3, axis=1))
    np.testing.assert_array_equal(seen[1], np.stack([shown[0], shown[0], shown[1]], axis=1))
    np.testing.assert_array_equal(seen[3], np.stack(shown[1:4], axis=1))
    policy.reset(np.array([1], dtype=np.int32))
    policy.act(shown[4])
    np.testing.assert_array_equal(seen[4][0], np.stack([frames[0] for frames in shown[2:]]))
    np.testing.assert_array_equal(seen[4][1], np.stack([shown[4][1]] * 3))
    with pytest.raises(ConfigurationError, match="frames are stacked of arrays"):
        make_policy(make, make_worlds(f"{ODD}:Mixed", 1))

"""Installed policies with options of their own, from TOML files."""

import dataclasses
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import armctl
from armctl.control.drive_nlp import DriveMpcOptions
from armctl.core.errors import ConfigurationError
from armctl.core.options import changed_options
from armctl.core.registration import installed
from armctl.envs import make_worlds
from armctl.policies import GROUP, configurations, is_code, make_policy, read_configuration
from armctl.policies.find import is_expert
from armctl.report import write_report
from armctl.runtime.identity import identity
from armctl.study import compare

REACH = "armctl/ArmReach-v0"
SHORT = 'policy = "reach_mpc"\nenv = "armctl/ArmReach-v0"\n[options.problem]\nhorizon = 4\n'


@pytest.fixture
def short(tmp_path):
    file = tmp_path / "short.toml"
    file.write_text(SHORT)
    return file


def test_it_acts_by_its_own_options(short):
    both = compare({"usual": "reach_mpc", "short": str(short)}, REACH, episodes=2).results.by_policy()
    usual, shorter = ([one.total_reward for one in played] for played in both.values())
    assert usual != shorter
    worlds = make_worlds(REACH, 2)
    made: Any = make_policy(short, worlds)
    assert [one.mpc.problem.horizon for one in made.controllers] == [4, 4]
    assert made.sees == "model"
    assert is_expert(short)


def test_other_options_are_another_comparison(short, tmp_path):
    def known():
        worlds = make_worlds(REACH, 1)
        return identity(REACH, {}, 0, {"it": str(short)}, {"it": make_policy(short, worlds)}, worlds)["objects"]

    before = known()
    assert known() == before
    short.write_text(SHORT.replace("4", "5"))
    assert known() != before


@pytest.mark.slow
@pytest.mark.parametrize("name", configurations())
def test_the_files_beside_experts_have_their_present_options(name, monkeypatch):
    """So that a tuning begins where the expert is."""
    told = read_configuration(configurations()[name])
    home = import_module(installed(GROUP)[name].module)
    changes = []

    def changed(usual, values, kind):
        changes.append((usual, changed_options(usual, values, kind)))
        return changes[-1][1]

    monkeypatch.setattr(home, "changed_options", changed)
    policies, short_episodes = {"plain": name, "same": str(configurations()[name])}, {"max_episode_steps": 25}
    plain, same = compare(policies, told.env, episodes=1, env_options=short_episodes).policies
    assert plain.episode_return.value == same.episode_return.value
    assert changes
    assert all(with_options == usual for usual, with_options in changes)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('policy = "reach_mcp"\nenv = "armctl/ArmReach-v0"', "Did you mean 'reach_mpc'"),
        ('policy = "mine.py:pd"\nenv = "armctl/ArmReach-v0"', "no installed policy"),
        ('policy = "reach_mpc"', "env: Field required"),
        ('policy = "reach_mpc"\nenv = "armctl/ArmReach-v0"\noption = {}', "Did you mean 'options'"),
        ('policy = "reach_mpc"\nenv = 3', "env: Input should be a valid string"),
        ("policy = ", "is not TOML"),
        ("a = " + "[" * 3000, "is nested too deeply"),
        ('policy = "random"\nenv = "armctl/ArmReach-v0"', "takes no options; those that do: bridge_"),
        (SHORT.replace("horizon", "horizn"), "Did you mean 'horizon'"),
        (SHORT.replace("4", "1"), "horizon: input should be greater than or equal to 2, not 1"),
        (SHORT.replace("4", "nan"), "horizon"),
        (SHORT.replace("[options.problem]\nhorizon", "[options]\nproblem"), "problem"),
    ],
)  # fmt: skip
def test_what_is_no_configuration_is_refused(tmp_path, text, message):
    file = tmp_path / "it.toml"
    file.write_text(text)
    with pytest.raises(ConfigurationError, match=message):
        make_policy(file, make_worlds(REACH, 1))


def test_a_missing_file_is_told(tmp_path):
    with pytest.raises(ConfigurationError, match=r"cannot be read: No such file"):
        armctl.make_policy(tmp_path / "no.toml", make_worlds(REACH, 1))


def test_options_within_options_change_alone():
    usual = DriveMpcOptions()
    changed = changed_options(usual, {"acceleration": [0.1, 0.2], "steps": 9})
    assert (changed.acceleration, changed.steps) == ((0.1, 0.2), 9)
    assert dataclasses.replace(changed, acceleration=usual.acceleration, steps=usual.steps) == usual


def test_it_can_be_named_from_elsewhere(short, monkeypatch):
    monkeypatch.chdir(short.parent)
    assert compare([Path("short.toml").name], REACH, episodes=1).policies[0].episodes == 1


@pytest.mark.slow
def test_a_name_has_options(short, tmp_path):
    named, usual = "reach_mpc:problem.horizon=4", "reach_mpc"
    short_episodes: Any = {"max_episode_steps": 20}
    study = compare(
        [usual, named, str(short)], REACH, episodes=2, workers=2, out=tmp_path / "results", env_options=short_episodes
    )
    returns = {name: [one.total_reward for one in played] for name, played in study.results.by_policy().items()}
    assert returns[named] == returns[str(short)] != returns[usual]
    assert "named on the command line" not in write_report(tmp_path / "results", video=True).read_text()
    assert is_expert(named)
    assert not is_code(named)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("reach_mpc:", "NAME:OPTION=VALUE"),
        ("reach_mpc:max_iterations", "NAME:OPTION=VALUE"),
        ("reach_mpc:max_iterations=False", "values as in TOML"),
        ("reach_mpc:problem.horizon=1", "horizon: input should be greater than or equal to 2, not 1"),
        ("reach_mpc:problem.horizn=9", "Did you mean 'horizon'"),
        ("reach_mpc:a=" + "[" * 3000, "NAME:OPTION=VALUE"),
        ("reach_mpc:a=1,a=2", "NAME:OPTION=VALUE"),
        ("random:prepared=true", "takes no options"),
        ("reach_mcp:prepared=true", "cannot load"),
    ],
)  # fmt: skip
def test_wrong_options_in_a_name_are_refused(name, message):
    with pytest.raises(ConfigurationError, match=message):
        make_policy(name, make_worlds(REACH, 1))

"""Foresight is declared, granted as declared, and told: without it, actions do not depend on the future."""

from contextlib import closing
from typing import Any

import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.envs.find import find_spec
from armctl.policies import WorldsByInterface, make_policy
from armctl.policies.catalogue import listed_policies, policies_of, privilege_in
from armctl.rollout import rollouts
from armctl.scene import PedestrianTrajectories
from armctl.tasks.reach.moving import ReachMovingTask, TargetTrajectory

from ..holding_still import Still

MOVING, BRIDGE = "armctl/ArmReachMoving-v0", "armctl/BridgeCrossMoving-v0"
NUM_ENVS, STEPS = 8, 30
"""Worlds and control steps after which the future changes."""
FORESEEING = {"bridge_mpc", "bridge_mppi", "bridge_ompl"}


def made_for(env):
    spec = find_spec(env)
    return sorted(policy.name for policy in policies_of(spec, listed_policies()) if policy.envs != "*")


def stop_everything_at(time, monkeypatch):
    """Let pedestrians and targets stand still from a time on: before, all is as it was."""
    people = PedestrianTrajectories.positions, PedestrianTrajectories.velocities
    monkeypatch.setattr(PedestrianTrajectories, "positions", lambda self, t: people[0](self, np.minimum(t, time)))
    monkeypatch.setattr(
        PedestrianTrajectories, "velocities",
        lambda self, t: np.where((np.asarray(t) <= time)[..., None, None], people[1](self, np.minimum(t, time)), 0.0),
    )  # fmt: skip
    curve, move = TargetTrajectory.positions, ReachMovingTask._move_targets

    def move_until(self, times):
        positions = move(self, np.minimum(times, time))
        self._target_velocities[times[-1] > time] = 0.0
        return positions

    monkeypatch.setattr(TargetTrajectory, "positions", lambda self, t: curve(self, np.minimum(t, time)))
    monkeypatch.setattr(ReachMovingTask, "_move_targets", move_until)


def actions_before_the_change(name, env, change=lambda time: None):
    n = 2 if name in DELIBERATE - FORESEEING else NUM_ENVS
    with closing(WorldsByInterface(env, n)) as interfaces:
        worlds = interfaces.of(name)
        policy = make_policy(name, worlds, policy_seed=1)
        observations, _ = worlds.reset(seed=[5] * n, options={"episode": list(range(n))})
        change((STEPS - 1) * worlds.control_period + 1e-6)
        policy.reset(np.arange(n, dtype=np.int32))
        actions = []
        for _ in range(STEPS):
            actions.append(np.array(policy.act(observations)))
            observations, *_ = worlds.step(actions[-1])
        return np.array(actions)


SHIPPED = [(env, name) for env in (MOVING, BRIDGE) for name in made_for(env)]
DELIBERATE = {"reach_mppi", "bridge_mppi", "bridge_lidar_ompl"}
"""Policies whose decisions take so long that their tests are slow ones."""


def test_there_are_shipped_policies_of_both_kinds():
    assert len(SHIPPED) >= 10
    assert {name for _, name in SHIPPED} >= {
        "reach_mpc",
        "reach_ik",
        "moving_ppo",
        "bridge_moving_imagined",
        *FORESEEING,
    }


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("env", "name"),
    [pytest.param(env, name, marks=[pytest.mark.slow] * (name in DELIBERATE), id=name) for env, name in SHIPPED],
)
def test_only_who_declares_foresight_depends_on_the_future(env, name, monkeypatch):
    with closing(WorldsByInterface(env, 1)) as interfaces:
        foresight = getattr(make_policy(name, interfaces.of(name)), "foresight", ())
    as_it_is = actions_before_the_change(name, env)
    as_it_stops = actions_before_the_change(name, env, lambda time: stop_everything_at(time, monkeypatch))
    assert np.array_equal(as_it_is, as_it_stops) == (foresight == ())
    assert (foresight != ()) == (name in FORESEEING)


def previews(foresight, sees="model", name="target"):
    """A policy that declares some foresight, asks for some, and notes what it gets."""
    notes = []

    @armctl.sees(sees, foresight=foresight)
    def make(env):
        return Still(sees, act=lambda: notes.append(env.preview(name, 1)))

    return make, notes


@pytest.mark.one_case
@pytest.mark.parametrize("sees", ["observation", "model", "map", "state"])
def test_who_declares_foresight_of_the_target_gets_its_curve(sees):
    make, notes = previews("target", sees)
    worlds = make_worlds(MOVING, 2)
    positions = []
    on_step = worlds.task.advance
    worlds.task.advance = lambda ids: (on_step(ids), positions.append(worlds.task._targets[1].copy()))
    results = [*rollouts(make_policy(make, worlds), worlds, 2, 0)]
    assert results[0].outcome == "timeout"
    times = worlds.control_period * np.arange(1, 6)
    np.testing.assert_allclose(notes[0].positions(times), positions[:5], atol=1e-9)


@pytest.mark.one_case
@pytest.mark.parametrize("sees", ["observation", "model", "map", "state"])
def test_who_does_not_declare_it_does_not_get_it(sees):
    make, notes = previews((), sees)
    failure = armctl.compare([make], MOVING, episodes=1).failures["make"]
    assert "target's future is only for a policy that declares to foresee it: put @armctl.sees(\"" in failure
    assert 'foresight="target")' in failure
    assert not notes
    other, notes = previews("pedestrians", sees)
    assert "target's future is only for" in armctl.compare([other], MOVING, episodes=1).failures["make"]
    assert not notes


@pytest.mark.slow
def test_the_map_of_people_is_for_who_foresees_them():
    def driver(**declaration):
        @armctl.sees("state", **declaration)
        def drive(env):
            policy = Still("state")
            policy.act = lambda observations: np.zeros((env.num_envs, 2)) * env.perceived().map(0).length
            return policy

        return drive

    options = {"max_episode_steps": 2, "observation": "state"}
    seeing = driver(foresight="pedestrians")
    for noise in ({}, {"disturbances": {"noise_on_state": 0.02}}):
        refused = armctl.compare([driver()], BRIDGE, episodes=1, env_options=options | noise)
        assert "pedestrians' future is only for a policy that declares to foresee it" in refused.failures["drive"]
        assert not armctl.compare([seeing], BRIDGE, episodes=1, env_options=options | noise).failures
    assert not armctl.compare([driver()], "BridgeCross-v0", episodes=1, env_options=options).failures


def test_the_level_of_a_disturbance_is_foresight_too():
    make, notes = previews("disturbance", name="disturbance")
    options = {"max_episode_steps": 2, "disturbances": {"payload": 1.5}}
    comparison = armctl.compare([make, "random"], "ArmReach-v0", episodes=2, worlds=2, env_options=options)
    assert notes[0] == {"payload": 1.5}
    assert comparison.facts.policies["make"].foresight == ("disturbance",)
    undisturbed = armctl.compare(
        [make, "random"], "ArmReach-v0", episodes=2, worlds=2, env_options={"max_episode_steps": 2}
    )
    assert undisturbed.facts.policies["make"].foresight == ()  # there is nothing to foresee


def test_a_policy_that_is_made_of_another_declares_as_much():
    inner, _ = previews("target")

    @armctl.sees("model")
    def outer(env):
        return make_policy(inner, env)

    with pytest.raises(ConfigurationError, match="target's future is only for"):
        make_policy(outer, make_worlds(MOVING, 2))
    with pytest.raises(ConfigurationError, match="target's future is only for"):
        make_policy(armctl.sees("state")(outer), make_worlds(MOVING, 2))
    for sees in ("model", "state"):
        make_policy(armctl.sees(sees, foresight="target")(outer), make_worlds(MOVING, 2))


def test_a_policy_that_says_so_too_late_and_names_that_there_are_not():
    def late(env):
        policy: Any = Still()
        policy.foresight = ("target",)
        return policy

    with pytest.raises(ConfigurationError, match="only for a policy that declares to foresee it"):
        make_policy(late, make_worlds(MOVING, 1))
    with pytest.raises(ConfigurationError, match=r"no foresight 'targte'.*Did you mean 'target'"):
        armctl.sees("model", foresight="targte")


@pytest.mark.slow
def test_foresight_that_differs_is_in_verdict_tables_and_json():
    options = {"max_episode_steps": 3}
    foreseeing, _ = previews("target")
    comparison = armctl.compare(
        {"preview": foreseeing, "reach_ik": "reach_ik"}, MOVING, episodes=10, worlds=2, env_options=options
    )
    privileges = "preview (observation + robot model + target's future), reach_ik (observation + robot model)"
    assert privileges.partition(", reach")[0] in comparison.verdict.context
    (table,) = (table for table in comparison.document().tables if table.key == "policies")
    by_name = {record["policy"]: record["foresight"] for record in table.records}
    assert by_name == {"preview": ("target",), "reach_ik": ()}
    assert "target's future" in str(table.rows)
    same = armctl.compare(["reach_mpc", "reach_ik"], MOVING, episodes=10, env_options=options)
    assert "privileges" not in same.verdict.context


def test_the_list_says_who_foresees_what():
    by_env = {
        env: {
            policy.name: privilege_in(find_spec(env), policy)
            for policy in policies_of(find_spec(env), listed_policies())
        }
        for env in (BRIDGE, "BridgeCross-v0", MOVING)
    }
    assert by_env[BRIDGE]["bridge_mpc"] == by_env[BRIDGE]["bridge_ompl"] == "true state + pedestrians' future"
    assert by_env["BridgeCross-v0"]["bridge_ompl"] == "true state"
    assert not any("future" in text for text in by_env[MOVING].values())

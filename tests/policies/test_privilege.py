"""A policy gets as much of the environment as it declares to see."""

import functools
from typing import Any

import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError
from armctl.envs import INTERFACES, SEES, make_worlds, privilege_in_words
from armctl.policies import PerWorld, make_policy, policy_names, privileges
from armctl.policies.names import declared_sees

from ..holding_still import Still

REACH, OBSTACLES, BRIDGE = "ArmReach-v0", "ArmReachObstacles-v0", "BridgeCrossMoving-v0"
SMALL = {"resolution": (4, 4)}


# Cheats that played, and won, when `sees` was only a label.


def moves_the_target(env):
    return Still(act=lambda: env.task._targets.__setitem__(slice(None), env.task.arm.end_effector_positions))


def through_unwrapped(env):
    inner = env.unwrapped
    return Still(act=lambda: inner.task.motion())


def through_the_spaces(env):
    env.single_action_space.high[:] = 1e6
    return Still()


def says_so_too_late(env):
    return Still(sees="state")


class TakesTheLiveWorld:
    def __init__(self, env):
        self.task = env.task

    def act(self, observation):
        return observation[3:9]


@pytest.mark.parametrize(
    ("cheat", "says"),
    [
        (through_unwrapped, r'env.unwrapped is not for .* sees the observation\..*@armctl.sees\("state"\)'),
        (TakesTheLiveWorld, r'env.task is not for .*@armctl.sees\("state"\)'),
        (
            says_so_too_late,
            r'a policy that sees the true state.*declared before it is made: put @armctl.sees\("state"\)',
        ),
    ],
)
def test_what_was_not_declared_is_not_given(cheat, says):
    with pytest.raises(ConfigurationError, match=says):
        make_policy(cheat, make_worlds(REACH, 2))


def test_a_cheat_that_reaches_for_the_world_only_when_it_acts_fails_too():
    failure = armctl.compare([moves_the_target], episodes=2).failures["moves_the_target"]
    assert "env.task is not for a policy that sees the observation" in failure


def test_an_interface_is_a_copy():
    worlds = make_worlds(REACH, 1)
    make_policy(through_the_spaces, worlds)
    actions: Any = worlds.single_action_space
    assert actions.high.max() < 10
    told = []
    make_policy(armctl.sees("model")(lambda env: told.append(env) or Still()), worlds)
    told[0].robot.limits.velocity[:] = 1e6
    told[0].options.reward["goal"] = None
    assert worlds.task.arm.description.limits.velocity.max() < 10
    assert worlds.task.options.reward["goal"] is not None
    with pytest.raises(TypeError):
        told[0].interface["robot"] = "another"
    with pytest.raises(AttributeError):
        told[0].num_envs = 5


def reachable_from(thing, depth=12):
    """Everything inside an object, its closures and bound methods included."""
    seen, waiting = {}, [(thing, depth)]
    while waiting:
        one, left = waiting.pop()
        if id(one) in seen or not left or isinstance(one, type):
            continue
        seen[id(one)] = one
        inside = list(getattr(one, "__dict__", {}).values())
        inside += one.values() if isinstance(one, dict) else one if isinstance(one, (list, tuple)) else ()
        inside += [cell.cell_contents for cell in getattr(one, "__closure__", None) or ()]
        inside += [part for name in ("__self__", "base") if (part := getattr(one, name, None)) is not None]
        waiting += [(part, left - 1) for part in inside]
    return seen.values()


@pytest.mark.parametrize("env", [REACH, OBSTACLES, BRIDGE, "Pendulum-v1"])
@pytest.mark.parametrize("sees", INTERFACES)
def test_nothing_in_an_interface_leads_to_the_simulation(env, sees):
    worlds, told = make_worlds(env, 2, SMALL if env == BRIDGE else None), []
    worlds.reset(seed=0)
    with pytest.raises(ConfigurationError, match="needs act"):
        make_policy(armctl.sees(sees)(lambda env: told.append(env)), worlds)
    inside = reachable_from(told[0])
    assert not any(one is worlds or one is worlds.task for one in inside)
    worlds.on_begin.clear()  # through these the environment tells, and is not told
    del worlds.clock
    arrays = [one for one in reachable_from([worlds, worlds.task]) if isinstance(one, np.ndarray) and one.size]
    for one in inside:
        assert not isinstance(one, np.ndarray) or not any(np.shares_memory(one, array) for array in arrays)


def test_each_privilege_has_what_the_ones_before_have_and_says_what_is_missing():
    worlds, given = make_worlds(OBSTACLES, 2), {}
    worlds.reset(seed=0)
    for sees in SEES:
        factory = armctl.sees(sees)(lambda env, sees=sees: given.setdefault(sees, env) and Still())
        assert make_policy(factory, worlds).sees == sees
    assert given["state"] is worlds
    assert given["model"].robot.dof == 6
    assert given["model"].options.tolerance == worlds.task.options.tolerance
    np.testing.assert_array_equal(given["map"].map(1).centres, worlds.task.boxes(1).centres)
    before = given["map"].map(1)
    worlds.reset(seed=5)
    np.testing.assert_array_equal(given["map"].map(1).centres, worlds.task.boxes(1).centres)
    assert before is not given["map"].map(1)
    for sees, name, needed in (
        ("observation", "robot", "model"), ("observation", "map", "map"), ("model", "map", "map"),
        ("map", "task", "state"), ("model", "episodes", "state"), ("observation", "seeds", "state"),
    ):  # fmt: skip
        with pytest.raises(AttributeError, match=rf'env.{name} is not .*@armctl.sees\("{needed}"\)'):
            getattr(given[sees], name)
    with pytest.raises(AttributeError, match="Did you mean 'num_envs'"):
        _ = given["observation"].num_env


def test_the_map_of_a_bridge_has_no_people():
    worlds, told = make_worlds(BRIDGE, 1, SMALL), []
    worlds.reset(seed=0)
    with pytest.raises(ConfigurationError):
        make_policy(armctl.sees("map")(lambda env: told.append(env)), worlds)
    np.testing.assert_array_equal(told[0].map().blocks, worlds.task.map(0).blocks)
    assert len(told[0].map().pedestrians.speed) == 0 < len(worlds.task.map(0).pedestrians.speed)


def test_all_worlds_or_one_have_the_spaces_that_the_environment_has():
    told = []

    class Plain:
        def __init__(self, env):
            told.append(env)

        def act(self, observation):
            return observation[3:9]

    worlds = make_worlds(REACH, 3)
    make_policy(Plain, worlds)
    make_policy(lambda env: told.append(env) or Still(), worlds)
    assert [env.action_space.shape for env in told] == [(6,)] * 3 + [(3, 6)]
    assert told[-1].observation_space == worlds.observation_space
    assert (told[-1].control_period, told[-1].max_episode_steps) == (0.04, 100)
    np.testing.assert_array_equal(told[-1].idle_action, worlds.task.idle_action)


def test_random_choices_are_the_episodes_own():
    def drawn(worlds, seed):
        told = []
        env = make_worlds(REACH, worlds)
        make_policy(lambda env: told.append(env) or Still(), env, policy_seed=5)
        env.reset(seed=seed)
        return [told[0].rng(i).random() for i in range(worlds)]

    assert drawn(1, 8) == drawn(2, 7)[1:]


def test_a_policy_made_of_another_declares_as_much():
    def borrowing(env):
        return make_policy("reach_ik", env)

    worlds = make_worlds(REACH, 1)
    with pytest.raises(ConfigurationError, match=r'reach_ik sees the observation \+ robot model.*sees\("model"\)'):
        make_policy(borrowing, worlds)
    assert make_policy(armctl.sees("model")(borrowing), worlds).sees == "model"
    assert make_policy(armctl.sees("state")(borrowing), worlds).sees == "state"
    partial = functools.partial(armctl.sees("model")(lambda env, name: make_policy(name, env)), name="reach_ik")
    assert make_policy(partial, worlds).sees == "model"


def test_a_misspelt_privilege_is_named():
    with pytest.raises(ConfigurationError, match="Did you mean 'state'"):
        armctl.sees("stat")
    with pytest.raises(ConfigurationError, match="no privilege 'pixels'"):
        make_policy(Still(sees="pixels"), make_worlds(REACH, 1))
    with pytest.raises(ConfigurationError, match="no privilege 'everything'"):
        make_policy(lambda env: PerWorld([], "everything"), make_worlds(REACH, 1))  # type: ignore[arg-type]


def test_installed_policies_declare_what_they_see():
    declared = {name: declared_sees(name) for name in policy_names()}
    omniscient = {
        "bridge_mpc", "bridge_mppi", "bridge_ompl", "bridge_robust_ppo", "bridge_state_ppo", "bridge_moving_state_ppo",
        "barn_moving_state_ppo", "barn_route_ppo", "bridge_moving_imagined", "bridge_orca", "mppi",
    }  # fmt: skip
    assert {name for name, sees in declared.items() if sees == "state"} == omniscient
    knowing = {"reach_ik", "reach_mpc", "reach_mppi", "reach_ompl", "obstacles_imagined", "obstacles_plan_bc"}
    knowing |= {"scenes_imagined", "scenes_plan_bc"}
    knowing |= {"moving_forecast", "moving_estimated", "bridge_cleaned"}
    knowing |= {"moving_robust_distil", "obstacles_ppo", "obstacles_robust_distil"}
    knowing |= {"bridge_dwa", "bridge_lidar_ompl", "bridge_pursuit"}
    knowing |= {"lift_grasp", "push_line", "reach_impedance", "reach_rate", "reach_ruckig"}
    assert {name for name, sees in declared.items() if sees == "model"} == knowing
    assert "map" not in declared.values()


def test_privileges_are_named_where_they_differ():
    assert privileges({"a": "observation", "b": "observation"}) == ""
    by_name = {"a": privilege_in_words("model"), "b": "observation", "c": privilege_in_words("pixels")}
    assert privileges(by_name) == (
        "Their privileges differ: a (observation + robot model), b (observation), c (pixels)."
    )
    comparison = armctl.compare(["reach_ik", "random"], episodes=10, worlds=10, env_options={"max_episode_steps": 3})
    assert "reach_ik (observation + robot model), random (observation)" in repr(comparison)
    assert "observation + robot model" in comparison._repr_html_()

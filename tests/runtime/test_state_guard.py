"""A policy that writes to the world is disqualified, and changes nothing for the others."""

import functools
import os
import re
import sys
from contextlib import closing

import numpy as np
import pytest

import armctl
from armctl.core.errors import Disqualified
from armctl.datasets.collect import collect
from armctl.envs import make_worlds, task_of
from armctl.episodes.failures import PolicyDisqualified
from armctl.policies import WorldsByInterface, make_policy
from armctl.policies.names import declared_sees
from armctl.report import write_report
from armctl.rollout.construction import build_policy
from armctl.rollout.loop import rollouts
from armctl.runtime.state_guard import StateGuard
from armctl.study.results import read_comparison

from ..holding_still import Still

REACH, OBSTACLES, BRIDGE = "ArmReach-v0", "ArmReachObstacles-v0", "BridgeCrossMoving-v0"
SMALL = {"resolution": (4, 4)}


def writes(name, index=Ellipsis, value=0.3, when="act"):
    """A policy that writes into an array of the task, by its path."""

    @armctl.sees("state")
    def cheat(env):
        def write():
            functools.reduce(getattr, name.split("."), env)[index] = value

        return Still("state", **{when: write})

    return cheat


def sets(path, value):
    @armctl.sees("state")
    def cheat(env):
        *holder, name = path.split(".")
        return Still("state", act=lambda: setattr(functools.reduce(getattr, holder, env), name, value))

    return cheat


@armctl.sees("state")
def moves_boxes(env):
    return Still("state", act=lambda: env.task.simulation.per_world("body_pos").__setitem__(Ellipsis, -9.0))


CHEATS = [
    (REACH, writes("task._targets"), "simulation.state|task._targets"),
    (REACH, writes("task.arm.joint_positions"), "task.state.joint_positions"),
    (REACH, writes("task.arm.joint_velocities", when="reset"), "task.arm._velocities"),
    (REACH, writes("task.state.distance", value=9.0), "task.state.distance"),
    (REACH, writes("_steps", value=0), "env._steps"),
    (REACH, writes("_episodes", value=3), "env._episodes"),
    (REACH, sets("max_episode_steps", 10**9), "env.max_episode_steps"),
    ("ArmReachMoving-v0", writes("task._within_for", value=9.0), "task._within_for"),
    ("ArmReachMoving-v0", writes("task._amplitudes", value=0.0), "task._amplitudes"),
    ("ArmPose-v0", writes("task.state.angle", value=0.0), "task.state.angle"),
    ("ArmPose-v0", writes("task._quaternions", value=0.5), "simulation.state|task._quaternions"),
    ("ArmLift-v0", writes("task._hand._commands"), "simulation.state|task._hand"),
    ("ArmPush-v0", writes("task._frictions", value=0.01), "simulation.pair_friction"),
    (OBSTACLES, writes("task._contacts._touched", value=0.5), "task._contacts._touched"),
    (OBSTACLES, moves_boxes, "simulation.body_pos"),
]


@pytest.mark.one_case
@pytest.mark.parametrize(("env", "cheat", "changed"), CHEATS, ids=[f"{env} {name}" for env, _, name in CHEATS])
def test_whoever_writes_to_the_world_is_disqualified(env, cheat, changed):
    worlds = make_worlds(env, 2)
    with pytest.raises(PolicyDisqualified, match=rf"cheat is disqualified: in episode 0, .*({changed})"):
        list(rollouts(make_policy(cheat, worlds), worlds, 2, 0, "cheat"))


def test_a_drivers_writing_is_noticed():
    @armctl.sees("state")
    def cheat(env):
        def act(observations):
            env.task._pedestrians.speed[:] = 0.0
            return np.zeros((env.num_envs, 2))

        policy = Still("state")
        policy.act = act
        return policy

    failure = armctl.compare([cheat], BRIDGE, episodes=1, env_options=SMALL).failures["cheat"]
    assert "task._pedestrians.speed" in failure


@pytest.mark.parametrize("env", ["Pendulum-v1", "Reacher-v5"])
def test_environments_of_others_are_watched_too(env):
    class Cheat:
        sees = "state"

        def __init__(self, env):
            self.inner = env.unwrapped
            self.action = np.zeros(env.action_space.shape)

        def act(self, observation):
            if env == "Pendulum-v1":
                self.inner.state = np.zeros(2)
            else:
                self.inner.data.qvel[:] = 0.0
            return self.action

    comparison = armctl.compare([Cheat, "random"], env, episodes=2)
    assert re.search(r"Cheat is disqualified.*world 0\.(state|data.qvel)", comparison.failures["Cheat"])
    assert [policy.policy for policy in comparison.policies] == ["random"]


def test_a_planner_may_try_actions_if_it_puts_the_world_back():
    @armctl.sees("state")
    def trying(env):
        q = env.task.arm.joint_positions

        def act():
            before = q.copy()
            q[:] += 0.1
            assert env.task.min_time(0) >= 0
            q[:] = before

        return Still("state", act=act)

    assert not armctl.compare([trying], episodes=2, env_options={"max_episode_steps": 5}).failures


@pytest.mark.slow
def test_none_of_its_episodes_count_and_everything_says_why(tmp_path):
    @armctl.sees("state")
    def late(env):
        return Still("state", act=lambda: env.episodes[0] == 2 and env.task._targets.fill(0.3))

    options = {"max_episode_steps": 4}
    for _ in range(2):  # the second time, in the same folder
        comparison = armctl.compare([late, "reach_ik", "random"], episodes=6, out=tmp_path, env_options=options)
        assert comparison.failures["late"].startswith("late is disqualified: in episode 2, it wrote to the world")
        assert [policy.policy for policy in comparison.policies] == ["reach_ik", "random"]
        assert "late" not in comparison.episodes.policy.tolist()
        assert any("late is disqualified" in getattr(part, "text", "") for part in comparison.document().parts)
        assert comparison.facts.disqualified == ["late"]
        (table,) = (one for one in comparison.document().tables if one.key == "policies")
        assert [(row[0].text, row[0].small) for row in table.rows][-1] == ("late", "disqualified")
        assert table.records[-1] == {"policy": "late", "disqualified": True}
    page = write_report(tmp_path, video=False).read_text()
    assert "late is disqualified" in page
    assert re.search(r"<b>late</b></td><td colspan=.8.>disqualified", page)
    workers = armctl.compare([late, "random"], episodes=4, workers=2, env_options=options)
    assert "late is disqualified" in workers.failures.get("late", ""), workers.failures
    assert [policy.policy for policy in workers.policies] == ["random"]


@pytest.mark.one_case
@pytest.mark.parametrize(
    "env", [REACH, "ArmLift-v0", "ArmPose-v0", "ArmPush-v0", "ArmReachMoving-v0", "ArmScenes-v0", OBSTACLES, BRIDGE]
)
def test_what_is_watched_holds_the_whole_state(env):
    worlds = make_worlds(env, 1, SMALL if env == BRIDGE else None)
    worlds.reset(seed=0)
    guard = StateGuard(worlds)
    for field in ("qpos", "qvel", "ctrl", "act", "mocap_pos", "xfrc_applied", "qfrc_applied", "time"):
        array = worlds.task.simulation.array(field)
        if array.size:
            with pytest.raises(Disqualified, match=r"simulation.state|task"), guard.assert_unchanged(new_episode=True):
                array += 0.01


def at_birth(write):
    """A policy that writes to the world as it is made, and then only holds still."""

    @armctl.sees("state")
    def cheat(env):
        write(env)
        return Still("state")

    return cheat


def widens_the_goal(worlds):
    vars(worlds.task.options)["tolerance"] = 10.0


def moves_the_target_at_birth(worlds):
    worlds.task._targets[:] = 0.3


def lifts_limits(worlds):
    worlds.task.arm.description.limits.velocity.setflags(write=True)
    worlds.task.arm.description.limits.velocity[:] = 1e3


def widens_the_actions(worlds):
    worlds.single_action_space.high[:] = 1e3


def gives_itself_time(worlds):
    worlds.max_episode_steps = 10**6


def takes_the_time_out_of_the_module(worlds):
    vars(sys.modules[type(worlds.task).__module__])["STEP_REWARD"] = 5.0


def changes_the_class(worlds):
    type(worlds.task).stops_at_target = not type(worlds.task).stops_at_target


BORN = {
    widens_the_goal: "task.options.tolerance", moves_the_target_at_birth: "task._targets",
    lifts_limits: "robot.limits.velocity", widens_the_actions: "env.single_action_space.high",
    gives_itself_time: "env.max_episode_steps", takes_the_time_out_of_the_module: "reach.STEP_REWARD",
    changes_the_class: "ReachTask.stops_at_target",
}  # fmt: skip


@pytest.mark.one_case
@pytest.mark.parametrize("write", BORN, ids=lambda write: write.__name__)
def test_whoever_writes_as_it_is_made_is_disqualified_and_changes_nothing_for_the_others(write):
    options = {"max_episode_steps": 4}
    alone = armctl.compare(["reach_ik", "random"], episodes=3, env_options=options).episodes
    asked = {"cheat": at_birth(write), "reach_ik": "reach_ik", "random": "random"}
    comparison = armctl.compare(asked, episodes=3, env_options=options)
    assert re.search(
        rf"cheat is disqualified: when it was made, it wrote to the world.*{re.escape(BORN[write])}",
        comparison.failures["cheat"],
    )
    assert comparison.facts.disqualified == ["cheat"]
    assert [policy.policy for policy in comparison.policies] == ["reach_ik", "random"]
    columns = ["policy", "episode", "outcome", "return", "length", "path_length"]
    assert comparison.episodes[columns].equals(alone[columns])


@pytest.mark.parametrize("when", ["act", "reset"])
def test_what_was_written_later_is_put_back_for_the_others_too(when):
    """Also a wider goal, which no reset would bring back."""

    @armctl.sees("state")
    def cheat(env):
        return Still("state", **{when: lambda: widens_the_goal(env)})

    def played(policies):
        episodes = armctl.compare(policies, episodes=3, env_options={"max_episode_steps": 4}).episodes
        return episodes[episodes.policy == "random"][["episode", "outcome", "return"]].values.tolist()

    assert played({"cheat": cheat, "random": "random"}) == played({"random": "random", "reach_ik": "reach_ik"})


def test_whoever_writes_and_then_raises_is_disqualified_too():
    @armctl.sees("state")
    def cheat(env):
        def act():
            widens_the_goal(env)
            raise ValueError("never mind")

        return Still("state", act=act)

    failure = armctl.compare([cheat], episodes=1).failures["cheat"]
    assert "cheat is disqualified: in episode 0, it wrote to the world" in failure


@pytest.mark.slow
def test_evaluate_collect_and_results_on_disk_know_of_it(tmp_path):
    cheat = at_birth(widens_the_goal)
    with pytest.raises(PolicyDisqualified, match="cheat is disqualified: when it was made"):
        armctl.evaluate(cheat, episodes=1)
    with pytest.raises(PolicyDisqualified, match="cheat is disqualified: when it was made"):
        collect(cheat, episodes=1, out=tmp_path / "data")
    assert not (tmp_path / "data" / "data").exists()
    for _ in range(2):  # the second time, in the same folder
        armctl.compare([cheat, "reach_ik"], episodes=2, out=tmp_path / "out", env_options={"max_episode_steps": 4})
        results = read_comparison(tmp_path / "out")
        assert results.facts.disqualified == ["cheat"]
        assert [policy.policy for policy in results.policies] == ["reach_ik"]


@pytest.mark.slow
def test_a_policy_that_is_made_in_a_worker_is_watched_there():
    """Whoever behaves in the process that waits, and not in those that play."""
    home = os.getpid()

    def write(worlds):
        if os.getpid() != home:
            vars(worlds.task.options)["tolerance"] = 10.0

    comparison = armctl.compare(
        {"cheat": at_birth(write), "random": "random"}, episodes=2, workers=2, env_options={"max_episode_steps": 4}
    )
    assert "cheat is disqualified: when it was made" in comparison.failures["cheat"]
    assert [policy.policy for policy in comparison.policies] == ["random"]


def test_environments_of_others_are_watched_as_a_policy_is_made():
    @armctl.sees("state")
    class Cheat:
        def __init__(self, env):
            env.unwrapped.max_torque, env.unwrapped.g = 100.0, 0.0
            self.idle = np.zeros(1)

        def act(self, observation):
            return self.idle

    comparison = armctl.compare([Cheat, "random"], "Pendulum-v1", episodes=1)
    assert re.search(
        r"Cheat is disqualified: when it was made, .*world 0\.(max_torque|g)", comparison.failures["Cheat"]
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "env", [REACH, "ArmLift-v0", "ArmPose-v0", "ArmPush-v0", "ArmReachMoving-v0", "ArmScenes-v0", OBSTACLES, BRIDGE]
)
def test_installed_policies_write_nothing_as_they_are_made(env):
    """There is no false alarm."""
    for name in task_of(env).default_policies:
        with closing(WorldsByInterface(env, 2)) as worlds:
            assert build_policy(name, worlds.of(name), name, 0).sees == declared_sees(name)

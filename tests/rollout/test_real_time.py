"""A world that does not wait: which command acts in which control step, by a clock that only the policy advances."""

import math
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pandas as pd
import pytest

import armctl
from armctl.core.errors import ConfigurationError, ResultsError
from armctl.report import write_report
from armctl.rollout.real_time import RealTime, RealTimePolicy, RecordedTimes, check_real_time
from armctl.study import compare, sweep
from armctl.study.results import read_comparison

from .. import command_line
from ..holding_still import HoldsStill

BRIDGE = "armctl/BridgeCross-v0"
SHORT = {"observation": "state", "max_episode_steps": 9}
PERIOD_MS = 100


class Echo(HoldsStill):
    """Commands what it observes."""

    asked = 0

    def act(self, observations):
        self.asked += 1
        return observations


def assert_same_episodes(one, other):
    """All columns, decision times too, but for the run that played them."""
    one, other = (comparison.episodes.drop(columns="run") for comparison in (one, other))
    pd.testing.assert_frame_equal(one, other, check_exact=True)


def schedule(times, steps, slow_down=1.0, cold=False):
    """The commands of control steps whose observations are 1, 2, 3 and so on, and the times of decisions."""
    real_time = RealTime(slow_down, "here", {"echo": {0: RecordedTimes(tuple(times), cold)}})
    task = SimpleNamespace(control_period=PERIOD_MS / 1e3, idle_action=np.zeros(1))
    echo = Echo()
    late = RealTimePolicy(echo, task, real_time, "echo")
    late.reset(np.zeros(1, dtype=np.int32), [0])
    found = [late.act(np.array([[float(step)]])) for step in range(1, steps + 1)]
    assert echo.asked == sum(not math.isnan(spent[0]) for _, spent, _ in found)
    return [int(command[0, 0]) for command, _, _ in found], [spent[0] for _, spent, _ in found]


def test_a_late_decision_takes_effect_when_it_is_ready_and_nobody_asks_before():
    times = [50, 250, 150, 10, 200, 101, 100]
    commands, spent = schedule(times, 12)
    # asked in step 2 for 2.5 periods: ready for step 5; in 5 for 1.5: for 7; in 8 for exactly 2: for 10; in 10: for 12
    assert commands == [1, 1, 1, 1, 2, 2, 7, 7, 7, 8, 8, 12]
    nan = math.nan
    np.testing.assert_equal(spent, [50, 250, nan, nan, 150, nan, 10, 200, nan, 101, nan, 100])


def test_before_the_first_command_the_robot_is_idle():
    assert schedule([250, 10, 10], 5)[0] == [0, 0, 0, 4, 5]
    assert schedule([250, 250, 10], 7)[0] == [0, 0, 0, 1, 1, 1, 7]


def test_a_cold_decision_is_not_held_against_the_policy():
    assert schedule([250, 250, 10], 5, cold=True)[0] == [1, 1, 1, 1, 5]


def test_a_slow_computer_is_late_where_a_fast_one_is_not():
    assert schedule([50, 30, 30, 30, 30], 4)[0] == [1, 2, 3, 4]
    assert schedule([50, 30, 30, 30, 30], 4, slow_down=2)[0] == [1, 2, 3, 4]  # exactly one period
    assert schedule([50, 30, 30, 30, 30], 6, slow_down=5)[0] == [0, 0, 0, 1, 1, 4]  # 250 ms, then 150 ms
    assert schedule([50, 30, 30, 30, 30], 6, slow_down=1000)[0] == [0] * 6


def test_times_come_again_without_the_planning_at_the_reset():
    assert schedule([250, 10, 20], 8)[1][3:] == [10, 20, 10, 20, 10]
    assert schedule([10], 3)[1] == [10, 10, 10]


def test_a_command_that_is_written_over_later_still_acts():
    class Reusing(Echo):
        actions = np.zeros((1, 1))

        def act(self, observations):
            self.actions[:] = observations
            return self.actions

    recorded = {"echo": {0: RecordedTimes((10, 250, 250), False)}}
    task = SimpleNamespace(control_period=0.1, idle_action=np.zeros(1))
    late = RealTimePolicy(Reusing(), task, RealTime(1.0, "here", recorded), "echo")
    late.reset(np.zeros(1, dtype=np.int32), [0])
    assert [late.act(np.array([[float(step)]]))[0][0, 0] for step in range(1, 6)] == [1, 1, 1, 1, 2]


def wandering(clock):
    """A policy with a memory that thinks longer and longer in each episode, and steers by what it sees."""

    class Wandering:
        def __init__(self):
            self.count = 0

        def reset(self):
            clock.now += 0.04
            self.count = 0

        def act(self, observation):
            self.count += 1
            clock.now += 0.03 * self.count
            return np.array([1.0, np.sin(self.count + float(np.sum(observation)))])

    return {"wandering": Wandering, "random": "random"}


@pytest.mark.slow
def test_recorded_times_repeat_a_measured_run_exactly_in_any_number_of_worlds(clock, tmp_path):
    arguments: dict[str, Any] = {"policies": wandering(clock), "env": BRIDGE, "episodes": 7, "env_options": SHORT}
    late = compare(**arguments, real_time="measured", slow_down=2, out=tmp_path / "late")
    waiting = compare(**arguments, out=tmp_path / "waiting")
    assert not late.failures
    lengths = {
        name: one.episodes.set_index(["policy", "episode"]).path_length
        for name, one in {"late": late, "waiting": waiting}.items()
    }
    assert (lengths["late"]["wandering"] != lengths["waiting"]["wandering"]).all()
    assert (lengths["late"]["random"] == lengths["waiting"]["random"]).all()
    for worlds in (1, 3, 7):
        again = compare(**arguments, worlds=worlds, real_time=tmp_path / "late", slow_down=2)
        assert_same_episodes(again, late)
    recorded = compare(**arguments, real_time=tmp_path / "waiting" / "decisions.csv", slow_down=2)
    assert_same_episodes(recorded, late)


@pytest.mark.slow
def test_real_time_in_processes_is_the_same(tmp_path):
    arguments: dict[str, Any] = {"policies": ["random"], "env": BRIDGE, "episodes": 3, "env_options": SHORT}
    compare(**arguments, out=tmp_path)
    here, there = (compare(**arguments, real_time=tmp_path, slow_down=9e3, workers=n) for n in (1, 2))
    assert_same_episodes(here, there)


@pytest.mark.slow
def test_late_decisions_are_missed_deadlines_and_results_say_how_they_came(clock, tmp_path):
    arguments: dict[str, Any] = {"env": BRIDGE, "episodes": 2, "env_options": SHORT}
    late = compare({"wandering": wandering(clock)["wandering"]}, **arguments, real_time="measured", slow_down=5,
                   out=tmp_path)  # fmt: skip
    (note,) = late.notes
    assert "longer than the control period, 100 ms," in note
    assert "as measured here, 5 times as long" in note
    # episode 0: cold; 60 ms take 3 steps, 90 take 5. Episode 1: 40 + 30 ms take 4 steps, 60 take 3, 90 take 5
    times = (tmp_path / "decisions.csv").read_text().splitlines()[1:]
    assert [row.split(",")[-1] for row in times] == [
        "30.0 60.0 nan nan 90.0 nan nan nan nan", "30.0 nan nan nan 60.0 nan nan 90.0 nan"
    ]  # fmt: skip
    assert late.episodes.reset_ms.tolist() == [40, 40]
    assert late.episodes.missed_deadlines.tolist() == [2, 3]
    assert late.policies[0].missed_deadlines == 1
    read = read_comparison(tmp_path)
    assert read.facts.real_time == {"latency": "measured", "slow_down": 5.0}
    page = write_report(tmp_path).read_text()
    assert "--real-time measured --slow-down 5" in page
    assert "Episodes in real time cannot be played again" in page
    with pytest.raises(ResultsError, match=r"real_time: slow_down 5.0 there, 6.0 here"):
        compare({"wandering": wandering(clock)["wandering"]}, **arguments, real_time="measured", slow_down=6.0,
                out=tmp_path)  # fmt: skip


def test_policies_are_told_how_many_control_steps_have_passed(clock):
    asked = []

    @armctl.sees("observation")
    def telling(env):
        class Telling:
            def act(self, observation):
                clock.now += 0.25
                asked.append(env.control_step())
                return env.idle_action

        return Telling()

    compare({"telling": telling}, BRIDGE, episodes=2, env_options=SHORT, real_time="measured")
    assert asked == [0, 1, 4, 7, 0, 3, 6]  # the first decision of all is cold


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded")
    compare("random", BRIDGE, episodes=2, env_options=SHORT, out=folder / "latencies")
    compare("random", BRIDGE, episodes=2, env_options=SHORT, out=folder / "shares", worlds=2)
    return folder


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"real_time": "measured", "worlds": 2}, "one world and one worker, not 2 and 1"),
        ({"real_time": "measured", "workers": 2}, "one world and one worker, not 1 and 2"),
        ({"slow_down": 5}, "add real_time='measured'"),
        ({"real_time": "measured", "slow_down": 0}, "above 0 and up to 10000, not 0"),
        ({"real_time": "measured", "slow_down": math.inf}, "not inf"),
        ({"real_time": "measured", "slow_down": "much"}, "not 'much'"),
        ({"real_time": "nowhere"}, "takes 'measured', or a folder"),
        ({"real_time": "latencies", "seed": 1}, "seed 0 there, 1 here"),
        ({"real_time": "latencies", "env": "armctl/BridgeCrossMoving-v0"}, "env armctl/BridgeCross-v0 there"),
        ({"real_time": "latencies", "episodes": 3}, "no decision times of random in episode 2"),
        ({"real_time": "latencies", "policies": "bridge_ompl"}, "no decision times of bridge_ompl in episode 0"),
        ({"real_time": "shares"}, "no latencies: they were taken with 2 worlds"),
        ({"real_time": "measured", "env": "CartPole-v1"}, "CartPole-v1 does not say its control period"),
    ],
)
def test_what_cannot_be_played_in_real_time_is_refused(recorded, tmp_path, arguments, says):
    given = {"policies": "random", "env": BRIDGE, "episodes": 2, "env_options": SHORT} | arguments
    if given["env"] == "CartPole-v1":
        given["env_options"] = {}
    if (folder := recorded / given.get("real_time", "none")).exists():
        given["real_time"] = folder
    with pytest.raises(ConfigurationError, match=says):
        compare(**given, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_actions_that_are_no_numbers_cannot_be_late():
    worlds: Any = SimpleNamespace(
        task=SimpleNamespace(control_period=0.1), single_action_space=gymnasium.spaces.Discrete(2)
    )
    with pytest.raises(ConfigurationError, match="real time needs actions that are numbers"):
        check_real_time("mine/Doors-v0", worlds)


@pytest.mark.slow
def test_success_against_slow_down_has_the_same_times_at_every_level(clock, tmp_path):
    arguments: dict[str, Any] = {"policies": wandering(clock), "env": BRIDGE, "episodes": 2, "env_options": SHORT}
    found = sweep(**arguments, disturbances={"slow-down": [5, 1]}, out=tmp_path)
    assert found.levels == {"slow-down": [0, 1, 5]}
    assert not found.failures
    assert found.points.level.tolist() == [0, 0, 1, 1, 5, 5]
    times = {name: one.episodes.decision_ms_p50.tolist() for name, one in found.comparisons.items()}
    assert times["slow-down-1.0"] != times["none"]  # late decisions are fewer
    for level in (1.0, 5.0):
        alone = compare(**arguments, real_time=tmp_path, slow_down=level)
        assert_same_episodes(alone, found.comparisons[f"slow-down-{level}"])
    said = repr(found.document())
    assert "slow-down: in real time, with the decision times of the undisturbed comparison" in said
    assert "takes effect when it is ready" not in said  # once, and not for each level
    page = write_report(tmp_path, video=False).read_text()
    assert "--disturbance slow-down=0,1,5" in page
    assert "the level of slow-down" in page


@pytest.mark.slow
def test_a_sweep_of_recorded_times_may_have_many_worlds(recorded, tmp_path):
    arguments: dict[str, Any] = {
        "env": BRIDGE,
        "episodes": 2,
        "env_options": SHORT,
        "disturbances": {"slow-down": [2], "delay": [1]},
    }
    found = sweep("random", **arguments, worlds=2, real_time=recorded / "latencies", out=tmp_path)
    assert not found.failures
    assert found.comparisons["slow-down-2.0"].facts.real_time == {
        "latency": str(recorded / "latencies"),
        "slow_down": 2.0,
    }
    assert found.comparisons["delay-1.0"].facts.real_time is None
    assert f"--real-time {recorded / 'latencies'}" in write_report(tmp_path, video=False).read_text()


@pytest.mark.slow
def test_more_episodes_extend_a_recording_and_what_repeats_it(tmp_path):
    arguments: dict[str, Any] = {
        "env": BRIDGE,
        "env_options": SHORT,
        "disturbances": {"slow-down": [2]},
        "out": tmp_path,
    }
    sweep("random", **arguments, episodes=1)
    more = sweep("random", **arguments, episodes=2)
    assert [one.resumed for one in more.comparisons.values()] == [1, 1]


def failing_at_once(env):
    return SimpleNamespace(act=lambda observation: 1 / 0)


def test_a_policy_without_times_is_told_and_spoils_nothing():
    found = sweep([failing_at_once, "random"], BRIDGE, episodes=1, env_options=SHORT, disturbances={"slow-down": [2]})
    assert found.failures["slow-down-2.0: failing_at_once"] == "no decision times of episode 0"
    assert found.points.policy.tolist() == ["random", "random"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"disturbances": {"slow-down": [2]}, "worlds": 2}, "one world and one worker, not 2 and 1"),
        ({"disturbances": {"slow-down": [-2]}}, "slow-down is a number from 0 to 10000"),
        ({"disturbances": {"slow-down": "fast"}}, "the levels of slow-down are numbers"),
        ({"disturbances": {"delay": [1]}, "real_time": "latencies"}, "real_time is for the levels of slow-down"),
        ({"disturbances": {"slow-down": [2]}, "real_time": "latencies", "episodes": 3}, "no decision times of random"),
        ({"disturbances": ["slow-down"], "env": "CartPole-v1", "env_options": {}}, "does not say its control period"),
    ],
)
def test_a_sweep_that_cannot_be_in_real_time_is_refused(recorded, tmp_path, arguments, says):
    given = {"policies": "random", "env": BRIDGE, "episodes": 2, "env_options": SHORT} | arguments
    if "real_time" in given:
        given["real_time"] = recorded / given["real_time"]
    with pytest.raises(ConfigurationError, match=says):
        sweep(**given, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_real_time_at_the_command_line(tmp_path):
    few = ("random", "--env", "Pendulum-v1", "--episodes", "1", "--set", "max_episode_steps=3")
    printed = command_line.armctl("compare", *few, "--real-time", "measured", "--slow-down", "2", cwd=tmp_path).stdout
    assert "In real time: a decision that takes longer than the control period, 50 ms," in printed
    printed = command_line.armctl("sweep", *few, "--slow-down", "1,30", "--format", "markdown", cwd=tmp_path).stdout
    assert "slow-down, times the decision times" in printed
    assert "noise" not in printed

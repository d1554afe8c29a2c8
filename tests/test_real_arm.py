"""The examples for real arms, with simulated ones that take the same calls, lose messages and fail."""

import csv
import gc
import sys
from pathlib import Path

import numpy as np
import pytest

import armctl
from armctl.control.reach import ReachController, ReachControllerOptions, State

EXAMPLES = Path(__file__).parents[1] / "examples"
ROS = ("rclpy", "rclpy.node", "sensor_msgs", "sensor_msgs.msg", "std_msgs", "std_msgs.msg")


@pytest.fixture
def examples(monkeypatch):
    """Make the examples importable, and undo what they do to the process: ROS's modules, garbage collection."""
    monkeypatch.syspath_prepend(EXAMPLES)
    for name in ROS:
        monkeypatch.setitem(sys.modules, name, None)
    yield
    gc.enable()


def logged(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


@pytest.mark.slow
@pytest.mark.parametrize("example", ["ur_rtde_reach", "ros2_control_reach"])
def test_a_planner_and_an_agent_reach_with_lost_and_late_messages(example, examples, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["fake"] if example == "ur_rtde_reach" else ["--fake"]
    module = __import__(example)
    module.main([*words, "--trials", "1", "--rate", "125", "--speed", "0.5"])
    rows = logged(tmp_path / "arm.csv")
    assert sorted((row["policy"], row["success"]) for row in rows) == [("reach_ik", "yes"), ("reach_ppo", "yes")]
    assert all(0.2 < float(row["time"]) < 5 for row in rows)
    assert "armctl judge arm.csv" in capsys.readouterr().out
    assert list(armctl.judge("arm.csv").cells) == ["arm"], "beside a simulated task, it has a name"


@pytest.mark.slow
def test_a_dropped_connection_ends_the_trials_and_the_next_call_goes_on(examples, tmp_path):
    import fake_robot
    import ur_rtde_reach
    from arm_trials import arguments, trials

    log = tmp_path / "arm.csv"
    given = arguments("").parse_args(["--log", str(log), "--policies", "reach_ik", "again", "--trials", "1"])
    given.background, given.rate, given.policies = False, 125.0, ["reach_ik", "reach_sac"]
    arm = fake_robot.FakeArm(link=fake_robot.Link(cut_at=0.4))
    control = fake_robot.RTDEControlInterface(arm, given.rate)
    receive = fake_robot.RTDEReceiveInterface(arm)
    session = trials(given)
    ur_rtde_reach.play(control, receive, session, 1 / given.rate)
    assert "no new measurement for" in session.fault
    assert [row["success"] for row in logged(log)] == ["no"]
    assert "fault: no new measurement" in logged(log)[0]["remark"]
    arm.tick(1000)
    assert not arm.protective_stop
    session = trials(given)
    ur_rtde_reach.play(control, receive, session, 1 / given.rate)
    assert [row["success"] for row in logged(log)] == ["no", "yes"]


def commanded(arm, controller, target_at, seconds):
    """Run a loop with a simulated arm, and return all set-points."""
    points = []
    while arm.time < seconds:
        stamp, q, qd = arm.measured
        point = controller.step(q, qd, target_at(arm.time), stamp)
        if point is not None:
            arm.send(point.position)
        points.append(point)
        arm.wait(round(controller.period / 0.002))
    return points


@pytest.mark.slow
def test_at_500_hz_with_jitter_the_arm_follows_and_is_never_asked_too_much(examples):
    import fake_robot

    link = fake_robot.Link(delay=0.004, loss=0.05, late=0.2)
    arm, controller = fake_robot.FakeArm(link=link), ReachController(options=ReachControllerOptions(background=False))
    first, second = np.array([0.4, 0.2, 0.5]), np.array([-0.3, 0.5, 0.4])
    points = commanded(arm, controller, lambda now: first if now < 0.4 else second, 3.0)
    assert points[-1].state is State.ARRIVED
    assert not arm.protective_stop
    command, q = (np.array([getattr(sample, name) for sample in arm.samples]) for name in ("command", "q"))
    assert np.linalg.norm(controller.model.position(q[-1]) - second) < 0.002
    lag = round(link.lookahead / fake_robot.PERIOD)
    assert np.abs(q[lag:] - command[:-lag]).max() < 0.04
    speeds = np.array([sample.qd for sample in arm.samples])
    assert (np.abs(speeds) < 0.7 * arm.limits.velocity).all()


@pytest.mark.slow
def test_the_firmware_of_the_simulated_arm_refuses_a_jump(examples):
    """Else the other tests would say little."""
    import fake_robot

    arm = fake_robot.FakeArm()
    arm.send(arm.measured[1] + 0.3)
    arm.tick(100)
    assert arm.protective_stop
    assert fake_robot.RTDEReceiveInterface(arm).isProtectiveStopped()

"""A robot that is not there: an arm in MuJoCo that takes the calls of `ur_rtde`, or of ROS 2, in a time of its own.

Messages are late and get lost, the loop of whoever commands it is late now and then, and the arm follows set-points
with a delay, as a UR does under `servoJ`. Its firmware stops it if a set-point asks for more speed than it has.
No time passes but in `FakeArm.tick`, so that what happens does not depend on the machine.
"""

import sys
import types
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import timedelta
from typing import Any

import mujoco
import numpy as np

from armctl.robot_description import load_arm
from armctl.robots import build_arm_world

PERIOD = 0.002
"""s: a physics step, and a cycle of the firmware."""


@dataclass(frozen=True)
class Link:
    """How badly messages travel between the arm and its controller, and what else goes wrong."""

    delay: float = 0.002
    """Mean delay of a message, s; each has its own, up to twice that."""
    loss: float = 0.0
    """Share of the messages that are lost, each way."""
    late: float = 0.0
    """Share of the loop's cycles that take longer, by up to `late_by` s."""
    late_by: float = 0.006
    cut_at: float = np.inf
    """s at which the connection drops, for `cut_for` s."""
    cut_for: float = 1.0
    nan_at: float = np.inf
    """s at which readings are no numbers, for `nan_for` s."""
    nan_for: float = 0.004
    lookahead: float = 0.05
    """s by which the arm follows its set-points late."""


@dataclass(frozen=True)
class Sample:
    """Command and motion of the arm at the end of a cycle."""

    time: float
    command: Any
    """(dof,) rad: the latest set-point that was sent."""
    q: Any
    qd: Any


class FakeArm:
    """An arm whose drives take set-points, behind a link."""

    def __init__(
        self, arm: str = "ur5", link: Link | None = None, seed: int = 0
    ) -> None:
        description = load_arm(arm)
        self.joints, self.limits = description.joints, description.limits
        self.link, self.rng = link or Link(), np.random.default_rng(seed)
        self._model = build_arm_world(description, "position")
        self._data = mujoco.MjData(self._model)
        mujoco.mj_resetDataKeyframe(self._model, self._data, 0)
        mujoco.mj_forward(self._model, self._data)
        self._dof = description.dof
        self._to_arm: deque[tuple[float, Any]] = deque()
        self._from_arm: deque[tuple[float, Any]] = deque()
        self.measured = (0.0, *self._state())
        """The latest measurement that has arrived: s, rad, rad/s."""
        self.command = self._goal = self._state()[0]
        self.protective_stop = False
        self.samples: list[Sample] = []
        self.on_tick: list[Callable[[], None]] = []

    @property
    def time(self) -> float:
        """Seconds since the arm was switched on."""
        return float(self._data.time)

    @property
    def is_cut(self) -> bool:
        """True while the connection is down."""
        return 0 <= self.time - self.link.cut_at < self.link.cut_for

    def send(self, q: Any) -> None:
        """Send a set-point (dof,) rad to the arm."""
        self.command = np.array(q, dtype=float)
        self._post(self._to_arm, self.command)

    def tick(self, cycles: int = 1) -> None:
        """Let time pass."""
        for _ in range(cycles):
            while self._to_arm and self._to_arm[0][0] <= self.time:
                self._goal = self._to_arm.popleft()[1]
            self._drive()
            mujoco.mj_step(self._model, self._data)
            q, qd = self._state()
            if 0 <= self.time - self.link.nan_at < self.link.nan_for:
                q = np.full(self._dof, np.nan)
            self._post(self._from_arm, (self.time, q, qd))
            while self._from_arm and self._from_arm[0][0] <= self.time:
                self.measured = self._from_arm.popleft()[1]
            self.samples.append(Sample(self.time, self.command, *self._state()))
            for call in self.on_tick:
                call()

    def wait(self, cycles: int) -> int:
        """Let the cycles of a loop pass, or some more if it is late; return how many more."""
        late = 0
        if self.rng.random() < self.link.late:
            longest = round(self.link.late_by / PERIOD)
            late = int(self.rng.integers(1, longest + 1))
        self.tick(cycles + late)
        return late

    def _drive(self) -> None:
        """Follow the set-point as a first-order lag; stop for good if that takes more speed than there is."""
        act, dof = self._data.act, self._dof
        speeds = (self._goal - act) / self.link.lookahead
        if (np.abs(speeds) > 1.05 * self.limits.velocity).any():
            self.protective_stop = True
        if self.protective_stop:
            change = self.limits.acceleration * PERIOD
            last = self._data.ctrl[:dof]
            speeds = np.sign(last) * np.maximum(np.abs(last) - change, 0)
        self._data.ctrl[:dof] = self._data.ctrl[dof:] = speeds

    def _post(self, messages: deque[tuple[float, Any]], message: Any) -> None:
        if self.is_cut or self.rng.random() < self.link.loss:
            return
        arrival = self.time + self.rng.uniform(0, 2 * self.link.delay)
        if messages:  # TCP keeps the order
            arrival = max(arrival, messages[-1][0])
        messages.append((arrival, message))

    def _state(self) -> tuple[Any, Any]:
        return self._data.qpos[: self._dof].copy(), self._data.qvel[
            : self._dof
        ].copy()


class RTDEControlInterface:
    """The calls of `rtde_control.RTDEControlInterface` that a servo loop needs (ur_rtde 1.6)."""

    def __init__(self, arm: FakeArm, frequency: float = 500.0) -> None:
        self._arm, self._cycles = arm, round(1 / frequency / PERIOD)

    def servoJ(  # noqa: N802
        self,
        q: list[float],
        speed: float,
        acceleration: float,
        time: float,
        lookahead_time: float,
        gain: float,
    ) -> bool:
        """Send a set-point."""
        if not 0.03 <= lookahead_time <= 0.2 or not 100 <= gain <= 2000:
            raise ValueError("lookahead_time or gain is out of range")
        self._arm.link = replace(self._arm.link, lookahead=lookahead_time)
        self._arm.send(q)
        return not self._arm.protective_stop

    def initPeriod(self) -> timedelta:  # noqa: N802
        """Return the time at which a cycle begins."""
        return timedelta(seconds=self._arm.time)

    def waitPeriod(self, t_cycle_start: timedelta) -> None:  # noqa: N802
        """Wait until the cycle ends."""
        self._arm.wait(self._cycles)

    def servoStop(self, a: float = 10.0) -> bool:  # noqa: N802
        """Stop servoing."""
        return True

    def stopScript(self) -> None:  # noqa: N802
        """End the program on the robot."""

    def isConnected(self) -> bool:  # noqa: N802
        """Return False while the connection is down."""
        return not self._arm.is_cut


class RTDEReceiveInterface:
    """The calls of `rtde_receive.RTDEReceiveInterface` that a servo loop needs (ur_rtde 1.6)."""

    def __init__(self, arm: FakeArm) -> None:
        self._arm = arm

    def getTimestamp(self) -> float:  # noqa: N802
        """Return the robot's time of the latest measurement, s."""
        return self._arm.measured[0]

    def getActualQ(self) -> list[float]:  # noqa: N802
        """Return joint positions, rad."""
        return list(self._arm.measured[1])

    def getActualQd(self) -> list[float]:  # noqa: N802
        """Return joint velocities, rad/s."""
        return list(self._arm.measured[2])

    def isConnected(self) -> bool:  # noqa: N802
        """Return False while the connection is down."""
        return not self._arm.is_cut

    def isProtectiveStopped(self) -> bool:  # noqa: N802
        """Return True if the firmware has stopped the arm."""
        return self._arm.protective_stop

    def isEmergencyStopped(self) -> bool:  # noqa: N802
        """Return False: nobody presses the button."""
        return False


def install_ros(arm: FakeArm) -> None:
    """Put modules with the calls of rclpy and ROS 2's messages that a node needs in the places of the real ones."""
    ros = Ros(arm)
    names = {
        "rclpy": {"init": ros.init, "ok": ros.ok, "spin_once": ros.spin_once,
                  "shutdown": ros.shutdown},
        "rclpy.node": {"Node": type("Node", (Node,), {"ros": ros})},
        "sensor_msgs.msg": {"JointState": types.SimpleNamespace},
        "std_msgs.msg": {"Float64MultiArray": types.SimpleNamespace},
    }  # fmt: skip
    for name in ("sensor_msgs", "std_msgs"):
        sys.modules[name] = types.ModuleType(name)
    for name, content in names.items():
        sys.modules[name] = types.ModuleType(name)
        vars(sys.modules[name]).update(content)


class Ros:
    """A ROS 2 graph of one node, an arm's `joint_state_broadcaster` and its `forward_position_controller`."""

    def __init__(self, arm: FakeArm) -> None:
        self.arm, self.subscribers = arm, dict[str, Callable[[Any], None]]()
        self.timers: list[list[Any]] = []
        self._is_up, self._stamp = False, 0.0

    def init(self, args: Any = None) -> None:
        """Begin."""
        self._is_up = True

    def ok(self) -> bool:
        """Return False after `shutdown`."""
        return self._is_up

    def shutdown(self) -> None:
        """End."""
        self._is_up = False

    def spin_once(self, node: "Node") -> None:
        """Let a cycle pass, deliver its messages and call timers that are due."""
        self.arm.wait(1)
        stamp, q, qd = self.arm.measured
        if stamp != self._stamp and "/joint_states" in self.subscribers:
            self._stamp = stamp
            self.subscribers["/joint_states"](self._message(stamp, q, qd))
        for timer in self.timers:
            period, due, call = timer
            if self.arm.time >= due:
                timer[1] = max(due + period, self.arm.time)
                call()

    def publish(self, topic: str, message: Any) -> None:
        """Send a set-point to the arm."""
        if topic == "/forward_position_controller/commands":
            self.arm.send(message.data)

    def _message(self, stamp: float, q: Any, qd: Any) -> Any:
        """Return a measurement as the broadcaster sends it, in an order of its own: by name."""
        order = np.argsort(self.arm.joints)
        seconds = int(stamp)
        time = types.SimpleNamespace(
            sec=seconds, nanosec=round(1e9 * (stamp - seconds))
        )
        return types.SimpleNamespace(
            header=types.SimpleNamespace(stamp=time),
            name=[self.arm.joints[i] for i in order],
            position=q[order].tolist(),
            velocity=qd[order].tolist(),
        )


class Node:
    """The calls of `rclpy.node.Node` that a node needs (ROS 2 Jazzy)."""

    ros: Ros

    def __init__(self, node_name: str) -> None:
        self._name = node_name

    def create_subscription(
        self,
        msg_type: Any,
        topic: str,
        callback: Callable[[Any], None],
        qos_profile: int,
    ) -> None:
        """Call a function with each message of a topic."""
        self.ros.subscribers[topic] = callback

    def create_publisher(
        self, msg_type: Any, topic: str, qos_profile: int
    ) -> Any:
        """Return an object with `publish`."""
        return types.SimpleNamespace(
            publish=lambda message: self.ros.publish(topic, message)
        )

    def create_timer(
        self, timer_period_sec: float, callback: Callable[[], None]
    ) -> None:
        """Call a function periodically."""
        self.ros.timers.append([timer_period_sec, self.ros.arm.time, callback])

    def get_logger(self) -> Any:
        """Return an object with `info`."""
        return types.SimpleNamespace(info=print)

    def destroy_node(self) -> None:
        """End."""

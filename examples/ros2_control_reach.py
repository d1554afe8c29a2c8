"""Reach with any arm of ros2_control: set-points for its `forward_command_controller`, from `/joint_states`.

Library: rclpy and the messages of ROS 2, which come with ROS (`source /opt/ros/jazzy/setup.bash`), not from PyPI.
Written against the documented calls, tried with those of a fake; not tried with ROS, nor on hardware: read
docs/real_robot.md first.

`ros2 control switch_controllers --activate forward_position_controller`, then
`python examples/ros2_control_reach.py`; with a simulated arm, and without ROS, `python examples/ros2_control_reach.py
--fake`.
"""

import gc
from typing import Any

from arm_trials import Trials, arguments, trials

STATES = "/joint_states"
COMMANDS = "/forward_position_controller/commands"


def node_class() -> type[Any]:
    """Return the class of the node, when ROS can be imported."""
    from rclpy.node import Node
    from sensor_msgs.msg import JointState
    from std_msgs.msg import Float64MultiArray

    class ReachNode(Node):  # type: ignore[misc]
        """Takes measurements as they come, and sends a set-point each period."""

        def __init__(self, session: Trials, period: float) -> None:
            super().__init__("armctl_reach")
            self.session = session
            self.measurement: tuple[Any, Any, float | None] = (None, None, None)
            self.create_subscription(JointState, STATES, self.on_state, 1)
            self.commands = self.create_publisher(
                Float64MultiArray, COMMANDS, 1
            )
            self.create_timer(period, self.on_timer)

        def on_state(self, message: Any) -> None:
            """Keep a measurement, in the order of armctl's joints."""
            names = list(message.name)
            if not set(self.session.joints) <= set(names):
                return  # of another part of the robot
            if len(message.velocity) < len(names):
                raise SystemExit(f"{STATES} has no velocities")
            order = [names.index(joint) for joint in self.session.joints]
            stamp = message.header.stamp
            self.measurement = (
                [message.position[i] for i in order],
                [message.velocity[i] for i in order],
                stamp.sec + 1e-9 * stamp.nanosec,
            )

        def on_timer(self) -> None:
            """Send a set-point."""
            point = self.session.step(*self.measurement)
            if point is not None:
                message = Float64MultiArray()
                message.data = point.position.tolist()
                self.commands.publish(message)

    return ReachNode


def main(words: list[str] | None = None) -> None:
    """Play the trials of a log."""
    parser = arguments(__doc__)
    parser.add_argument("--fake", action="store_true")
    given = parser.parse_args(words)
    given.background = not given.fake
    if given.fake:
        import fake_robot

        link = fake_robot.Link(loss=0.01, late=0.05)
        fake_robot.install_ros(fake_robot.FakeArm(link=link))
    import rclpy

    rclpy.init()
    session = trials(given)
    gc.disable()  # a collection would take 0.1 s of a cycle
    node = node_class()(session, 1 / given.rate)
    while rclpy.ok() and not session.is_over:
        rclpy.spin_once(node)
    node.destroy_node()
    rclpy.shutdown()
    if session.fault:
        raise SystemExit(f"the trials ended by a fault: {session.fault}")
    print(f"armctl judge {given.log}")


if __name__ == "__main__":
    main()

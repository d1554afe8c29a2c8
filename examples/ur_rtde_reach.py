"""Reach with a UR through `ur_rtde`: a planner and a learned agent, one trial after the other, into one log.

Library: ur_rtde, `pip install ur-rtde`. `servoJ` gets a set-point in each cycle.
Not tried on hardware: read docs/real_robot.md first.

`python examples/ur_rtde_reach.py fake` plays with a simulated arm, and an address in place of `fake` with a real one;
then `armctl judge arm.csv`.
"""

import gc
from typing import Any

from arm_trials import Trials, arguments, trials

LOOKAHEAD, GAIN = 0.05, 500.0
"""s, and the gain, of `servoJ`."""
CONTROLLER_STOP = 10.0
"""m/s^2: with what `servoStop` brakes what moves at the end."""


def connect(host: str, rate: float) -> tuple[Any, Any]:
    """Return the interfaces to command and to measure an arm."""
    if host == "fake":
        import fake_robot

        arm = fake_robot.FakeArm(link=fake_robot.Link(loss=0.01, late=0.05))
        control = fake_robot.RTDEControlInterface(arm, rate)
        return control, fake_robot.RTDEReceiveInterface(arm)
    from rtde_control import RTDEControlInterface
    from rtde_receive import RTDEReceiveInterface

    return RTDEControlInterface(host, rate), RTDEReceiveInterface(host, rate)


def play(control: Any, receive: Any, session: Trials, period: float) -> None:
    """Send a set-point in each cycle until the trials are over, or something stops the arm."""
    gc.disable()  # a collection would take 0.1 s of a cycle
    try:
        while not session.is_over:
            began = control.initPeriod()
            if receive.isProtectiveStopped() or receive.isEmergencyStopped():
                raise SystemExit("the robot has stopped itself")
            q, qd = receive.getActualQ(), receive.getActualQd()
            point = session.step(q, qd, receive.getTimestamp())
            if point is not None:
                q = point.position.tolist()
                if not control.servoJ(q, 0.0, 0.0, period, LOOKAHEAD, GAIN):
                    raise SystemExit("the robot takes no set-points any more")
            control.waitPeriod(began)
    finally:
        control.servoStop(CONTROLLER_STOP)
        control.stopScript()


def main(words: list[str] | None = None) -> None:
    """Play the trials of a log."""
    parser = arguments(__doc__)
    parser.add_argument("host", help="the robot's address, or fake")
    given = parser.parse_args(words)
    given.background = given.host != "fake"
    session = trials(given)
    play(*connect(given.host, given.rate), session, 1 / given.rate)
    if session.fault:
        raise SystemExit(f"the trials ended by a fault: {session.fault}")
    print(f"armctl judge {given.log}")


if __name__ == "__main__":
    main()

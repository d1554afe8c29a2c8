"""A loop at 500 or 125 Hz with a simulated arm: limits that are kept, how well it is followed, and what faults do.

    python benchmarks/set_points.py [--targets 20] [--seed 300] [--real-time 20]

`armctl.control.reach` commands `examples/fake_robot.py`: MuJoCo's UR5 behind a link that delays and loses messages, and
whose loop is late now and then. Shares are of the limits that are used: half of the arm's velocity, a quarter of its
acceleration and jerk. Everything is in simulated time; the time of a step is the processor's.
"""

import functools
import gc
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import typer
from printing import progress, show, versioned_table

from armctl.control.reach import ReachController, ReachControllerOptions, State
from armctl.envs import make_worlds
from armctl.kinematics import ArmModel, Workspace
from armctl.policies import make_policy
from armctl.robot_description import BUILTIN_ARMS

sys.path.append(str(Path(__file__).parents[1] / "examples"))
from fake_robot import PERIOD, FakeArm, Link

GOOD, USUAL, BAD = Link(), Link(loss=0.01, late=0.05), Link(delay=0.006, loss=0.1, late=0.2)
EVENT = 0.5
"""s after the beginning at which something happens."""
LIMIT = 6.0
"""s until a target counts as missed."""


@dataclass
class Run:
    """Commands and measurements of a loop."""

    points: list[Any] = field(default_factory=list)
    lateness: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    samples: list[Any] = field(default_factory=list)
    reached: int = 0
    targets: int = 0

    def shares(self, controller: ReachController) -> list[float]:
        """Return the largest velocity, acceleration and jerk of set-points, as shares of their limits."""
        limits, period = controller._motion.limits, controller.period
        velocity, acceleration = (np.array([getattr(p, name) for p in self.points]) for name in
                                  ("velocity", "acceleration"))  # fmt: skip
        jerk = np.diff(acceleration, axis=0) / period
        pairs = (velocity, limits.velocity), (acceleration, limits.acceleration), (jerk, limits.jerk)
        return [float((np.abs(values) / limit).max()) for values, limit in pairs]

    def errors(self, lookahead: float) -> tuple[float, float]:
        """Return the largest distance of a joint from its set-point, rad: now, and as it was `lookahead` (s) before."""
        command, q = np.array([s.command for s in self.samples]), np.array([s.q for s in self.samples])
        shift = round(lookahead / PERIOD)
        return float(np.abs(q - command).max()), float(np.abs(q[shift:] - command[:-shift]).max())


def follow(controller: ReachController, arm: FakeArm, target_at: Callable[[float], Any], run: Run, until: float) -> Any:
    """Run the loop until the target is reached and the arm rests, or until `until` (s); return the last set-point."""
    return loop(controller, arm, run, until, lambda q, qd, stamp: controller.step(q, qd, target_at(arm.time), stamp))


def constant(target: Any, _: float) -> Any:
    """Return the target at any time."""
    return target


def go_home(controller: ReachController, arm: FakeArm, run: Run) -> None:
    """Bring the arm to where episodes begin."""
    home = controller.model.home
    loop(controller, arm, run, arm.time + LIMIT, lambda q, qd, stamp: controller.step_to(q, qd, home, stamp))


def loop(controller: ReachController, arm: FakeArm, run: Run, until: float, step: Callable[..., Any]) -> Any:
    """Send set-points until the arm has arrived, or until `until` (s); return the last one, None for a fault."""
    cycles, point = round(controller.period / PERIOD), None
    while arm.time < until:
        stamp, q, qd = arm.measured
        began = time.thread_time()
        point = step(q, qd, stamp)
        run.seconds.append(time.thread_time() - began)
        if point is not None:
            arm.send(point.position)
            run.points.append(point)
            if point.state is State.ARRIVED and (controller._act is not None or controller._motion.is_at_rest):
                break
        run.lateness.append(arm.wait(cycles))
    run.samples += arm.samples
    arm.samples.clear()
    return point


def reaching(link: Link, rate: float, targets: Any, agent: Any = None, name: str = "ur5") -> list[str]:
    """Return a row on targets, each from home."""
    act = None if agent is None else lambda observation: agent.act(np.float32(observation)[None])[0]
    controller = ReachController(name, ReachControllerOptions(rate=rate, background=False), act=act)
    arm, run = FakeArm(name, link), Run()
    for target in targets:
        go_home(controller, arm, run)
        if agent is not None:
            agent.reset(np.zeros(1, dtype=np.int32))
        point = follow(controller, arm, functools.partial(constant, target), run, arm.time + LIMIT)
        run.reached += point is not None and point.state is State.ARRIVED
    lateness = 1000 * PERIOD * np.array(run.lateness)
    error, delayed_error = run.errors(arm.link.lookahead)
    limits = arm.limits.velocity
    fastest = max(float((np.abs(s.qd) / limits).max()) for s in run.samples)
    return [
        f"{run.reached} of {len(targets)}", f"{(lateness > 0).mean():.0%}, {lateness.max():.0f} ms",
        *(f"{share:.1%}" for share in run.shares(controller)), f"{fastest:.0%}", f"{error:.3f}", f"{delayed_error:.3f}",
        f"{1e3 * np.mean(run.seconds):.2f}, {1e3 * np.quantile(run.seconds, 0.99):.2f}, {1e3 * max(run.seconds):.1f}",
    ]  # fmt: skip


def in_real_time(rate: float, targets: Any, seconds: float) -> list[str]:
    """Return a row on how late set-points are by the clock, with plans in a thread."""
    controller, arm = ReachController(options=ReachControllerOptions(rate=rate)), FakeArm(link=GOOD)
    cycles, delays = round(controller.period / PERIOD), list[float]()
    due = time.perf_counter()
    for k in range(round(seconds * rate)):
        arm.tick(cycles)
        stamp, q, qd = arm.measured
        time.sleep(max(0.0, due - time.perf_counter()))
        point = controller.step(q, qd, targets[int(k / rate) % len(targets)], stamp)
        delays.append(time.perf_counter() - due)
        due = max(due, time.perf_counter() - controller.period) + controller.period
        assert point is not None
        arm.send(point.position)
    controller.close()
    times = [1e3 * float(np.quantile(delays, share)) for share in (0.5, 0.99, 0.999, 1.0)]
    return [f"{rate:.0f} Hz", f"{seconds:.0f} s", *(f"{value:.2f}" for value in times)]


def faults(targets: Any) -> Iterator[list[str]]:
    """Yield rows on what happens."""
    first, second = targets[:2]

    def changing(other: Any) -> Callable[[float], Any]:
        return lambda seconds: first if seconds < EVENT else other

    def circle(seconds: float) -> Any:
        return first + 0.05 * np.array([np.sin(2 * seconds), np.cos(2 * seconds) - 1, 0.0])

    into_floor = np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])
    cases: list[tuple[str, Link, Callable[[float], Any], Callable[[ReachController], None]]] = [
        ("the target jumps", USUAL, changing(second), leave),
        ("the target moves at 0.1 m/s", USUAL, circle, leave),
        ("the target goes out of reach", USUAL, changing(np.array([2.0, 0, 0.5])), leave),
        ("the target is not a number", USUAL, changing(np.full(3, np.nan)), leave),
        ("there is no target any more", USUAL, changing(None), leave),
        ("planning fails", USUAL, changing(second), fail_after_first),
        ("an agent wants the arm in the floor", USUAL, lambda _: first, lambda c: act_with(c, into_floor)),
        ("an agent fails", USUAL, lambda _: first, lambda c: act_with(c, None)),
        ("readings are not numbers for 4 ms", replaced(nan_at=EVENT), lambda _: first, leave),
        ("readings are not numbers for 1 s", replaced(nan_at=EVENT, nan_for=1.0), lambda _: first, leave),
        ("the connection drops for 30 ms", replaced(cut_at=EVENT, cut_for=0.03), lambda _: first, leave),
        ("the connection drops for 1 s", replaced(cut_at=EVENT, cut_for=1.0), lambda _: first, leave),
        ("the arm stops itself", USUAL, lambda _: first, leave),
    ]
    for name, link, target_at, change in progress(cases):
        controller = ReachController(options=ReachControllerOptions(background=False))
        arm, run = FakeArm(link=link), Run()
        change(controller)
        if name == "the arm stops itself":
            follow(controller, arm, target_at, run, EVENT)
            arm.protective_stop = True
        point = follow(controller, arm, target_at, run, LIMIT)
        result, braked = outcome(controller, run, point)
        if point is not None and point.state is State.ARRIVED:
            miss = controller.model.position(run.samples[-1].q) - target_at(arm.time)
            result += f", {1e3 * np.linalg.norm(miss):.1f} mm off"
        yield [name, result, braked, *(f"{share:.1%}" for share in run.shares(controller))]


def outcome(controller: ReachController, run: Run, point: Any) -> tuple[str, str]:
    """Return what it came to, and how long the arm braked."""
    stopping = [p for p in run.points if p.state is State.STOPPING]
    braked = f"{1e3 * controller.period * len(stopping):.0f} ms" if stopping else "-"
    if point is None:
        return f"fault: {controller.fault}", braked
    reason = next((p.reason for p in [*stopping, point] if p.reason), "")
    return f"{point.state.value}{f': {reason}' if reason else ''}", braked


def replaced(**changes: float) -> Link:
    """Return the usual link with something that goes wrong."""
    return Link(loss=USUAL.loss, late=USUAL.late, **changes)


def leave(controller: ReachController) -> None:
    """Change nothing."""


def fail_after_first(controller: ReachController) -> None:
    """Make all plans but the first fail."""
    choose, calls = controller._choose, []

    def failing(*arguments: Any) -> Any:
        calls.append(1)
        if len(calls) > 1:
            raise RuntimeError("a planner's error")
        return choose(*arguments)

    controller._choose = failing  # type: ignore[assignment]


def act_with(controller: ReachController, goal: Any) -> None:
    """Replace the planner by an agent that moves the joints by `goal` all the time, or raises an error."""

    def act(observation: Any) -> Any:
        if goal is None:
            raise RuntimeError("an agent's error")
        return observation[3:9] + goal

    controller._act = act


def sampled(name: str, number: int, seed: int) -> list[Any]:
    """Return places that an arm reaches, at least 0.2 m from its base and the floor."""
    workspace, rng = Workspace(ArmModel(name)), np.random.default_rng(seed)
    return [workspace.sample(rng, 0.2) for _ in range(number)]


def main(targets: int = 20, seed: int = 300, real_time: float = 0.0) -> None:
    """Print the tables; the last one takes `real_time` (s) for each rate, on an idle machine."""
    gc.disable()
    places = sampled("ur5", targets, seed)
    reached = versioned_table(
        "set-points", "link", "reached", "late cycles, largest", "velocity", "acceleration", "jerk",
        "arm's velocity", "off the set-point, rad", "off the delayed one, rad", "ms of a step: mean, 99 %, max",
    )  # fmt: skip
    agent = make_policy("reach_ppo", make_worlds("armctl/ArmReach-v0", 1))
    for rate, name, link in ((500, "good", GOOD), (500, "usual", USUAL), (500, "bad", BAD), (125, "usual", USUAL)):
        reached.add_row(f"planned, {rate} Hz", name, *reaching(link, rate, places))
    for rate in (500, 125):
        reached.add_row(f"`reach_ppo`, {rate} Hz", "usual", *reaching(USUAL, rate, places, agent))
    for name in BUILTIN_ARMS:
        if name != "ur5":
            row = reaching(USUAL, 125, sampled(name, targets, seed), name=name)
            reached.add_row(f"planned, 125 Hz, `{name}`", "usual", *row)
    happened = versioned_table("half a second after the start", "outcome", "brakes for", "velocity", "acceleration",
                               "jerk")  # fmt: skip
    for row in faults(places):
        happened.add_row(*row)
    show(reached, happened, width=250)
    if real_time:
        clock = versioned_table("loop by the clock", "for", "set-point late by, ms: median", "99 %", "99.9 %", "most")
        for rate in (500, 125):
            clock.add_row(*in_real_time(rate, places, real_time))
        show(clock, width=250)


if __name__ == "__main__":
    typer.run(main)

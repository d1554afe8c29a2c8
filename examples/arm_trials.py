"""Trials of a real arm: targets one after the other, each from home, by the policy that a log has drawn for it.

Targets are those of `armctl/ArmReach-v0` with the log's seed, so that a simulation of the same seed has the same ones.
"""

import argparse
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from armctl.control.reach import (
    ReachController,
    ReachControllerOptions,
    SetPoint,
    State,
)
from armctl.judging.log import TrialLog

ENV = "armctl/ArmReach-v0"
TASK = "arm"
"""The task of a log that these trials begin, beside the simulated one."""
HOME_TIME = 30.0
"""s that the way home may take."""


def arguments(description: str | None) -> argparse.ArgumentParser:
    """Return a parser of what to play, and how fast."""
    parser = argparse.ArgumentParser(
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--arm", default="ur5", help="default: %(default)s")
    parser.add_argument("--log", type=Path, default=Path("arm.csv"))
    parser.add_argument(
        "--policies",
        nargs="+",
        default=["reach_ik", "reach_ppo"],
        help="reach_ik, and agents of armctl/ArmReach-v0; default: %(default)s",
    )
    parser.add_argument("--trials", type=int, default=10, help="of each policy")
    parser.add_argument("--seed", type=int, default=300, help="of the targets")
    parser.add_argument("--time-limit", type=float, default=10.0, help="s")
    parser.add_argument("--rate", type=float, default=500.0, help="Hz")
    parser.add_argument(
        "--speed", type=float, default=0.25, help="share of the speed limits"
    )
    return parser


class Trials:
    """Plays what is left of a log, set-point by set-point: call `step` once a period until `is_over`."""

    def __init__(self, log: TrialLog, given: argparse.Namespace) -> None:
        self.log, self._time_limit = log, given.time_limit
        options = ReachControllerOptions(
            rate=given.rate, velocity=given.speed, background=given.background
        )
        self._agents = {name: agent(name, given.arm) for name in log.policies}
        self._controllers = {
            name: ReachController(given.arm, options, act=policy and policy.act)
            for name, policy in self._agents.items()
        }
        self.targets = targets(log.episodes, log.seed, given.arm)
        self.is_over, self.fault = log.is_complete, ""
        self._begin()

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in the order of set-points."""
        return self._controller.model.description.joints

    def step(self, q: Any, qd: Any, stamp: float | None) -> SetPoint | None:
        """Return the next set-point for a measurement; None is one to wait for, or the end."""
        controller, self._ticks = self._controller, self._ticks + 1
        if self._phase == "home":
            point = controller.step_to(q, qd, controller.model.home, stamp)
        else:
            target = self._target if self._phase == "reach" else None
            point = controller.step(q, qd, target, stamp)
        if point is None:
            self._end_by_fault(controller.fault)
        elif self._phase == "home":
            self._go_on_from_home(point)
        elif self._phase == "reach":
            is_late = self._seconds > self._time_limit
            if point.state is State.ARRIVED or is_late:
                self._end(not is_late, point.reason)
        elif point.state is State.WAITING:
            self.is_over = self.log.is_complete
            self._begin()
        return point

    @property
    def _seconds(self) -> float:
        return self._ticks * self._controller.period

    def _begin(self) -> None:
        """Go home for the next trial."""
        if not self.log.is_complete:
            episode, policy = self.log.schedule[len(self.log.rows)]
            self._target = self.targets[episode - 1]
            self._controller = self._controllers[policy]
            self._controller.acknowledge()
            if (learned := self._agents[policy]) is not None:
                learned.reset()
        self._phase, self._ticks = "home", 0

    def _go_on_from_home(self, point: SetPoint) -> None:
        if point.state is State.ARRIVED:
            self._phase, self._ticks = "reach", 0
        elif point.state is State.BLOCKED or self._seconds > HOME_TIME:
            reason = point.reason or "it takes too long"
            self.fault, self.is_over = f"no way home: {reason}", True

    def _end_by_fault(self, fault: str) -> None:
        """End all trials if there is a fault: somebody has to look."""
        if fault and self._phase == "reach":
            self._end(False, f"fault: {fault}")
        self.fault, self.is_over = fault, bool(fault) or self.is_over

    def _end(self, success: bool, remark: str) -> None:
        self.log.add(success, round(self._seconds, 3), remark)
        self._phase = "stop"


def trials(given: argparse.Namespace) -> Trials:
    """Return the trials of a log, which begins if there is none."""
    if given.log.exists():
        log = TrialLog.read(given.log)
    else:
        log = TrialLog.begin(
            given.log, given.policies, given.trials, given.seed, False,
            task=TASK,
        )  # fmt: skip
    return Trials(log, given)


class Agent:
    """A learned agent: what it observes, and what it decides."""

    def __init__(self, name: str, arm: str) -> None:
        from armctl.envs import make_worlds
        from armctl.policies import make_policy

        self._policy = make_policy(name, make_worlds(ENV, 1, {"robot": arm}))

    def reset(self) -> None:
        """Forget the last trial."""
        self._policy.reset(np.zeros(1, dtype=np.int32))

    def act(self, observation: Any) -> Any:
        """Return joint positions to move to."""
        return self._policy.act(np.float32(observation)[None])[0]


def agent(name: str, arm: str) -> Agent | None:
    """Return a learned agent; None for the planner, `reach_ik`."""
    return None if name == "reach_ik" else Agent(name, arm)


def targets(number: int, seed: int, arm: str) -> list[Any]:
    """Return the targets (3,) m of the first episodes of a seed."""
    env = gymnasium.make(ENV, robot=arm)
    return [
        np.array(env.reset(seed=None if k else seed)[0][-3:], dtype=float)
        for k in range(number)
    ]

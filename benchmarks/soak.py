"""Effect of hostile actions on the physics: worlds that explode, silent resets, and excess over limits.

    python benchmarks/soak.py [--steps 1000000] [--env ArmReach-v0] [--control torque] [--disturbed] [--seed 0]

Each environment makes `steps` control steps, shared among its control modes, with five kinds of actions, each in a
fifth of the worlds. A collision does not end an episode here, unless people walk there: robots push on into what they
have hit. Joint positions, joint speeds and contacts are read after every physics step. Penetration is that of arms and
of the rover's chassis: its tyres are of soft rubber, and people walk in steps of 24 mm, whoever stands there. Under
`mismatch`, arms with short links stand in the floor or in themselves from the start, and what overlaps then does not
count. With `--disturbed`, each disturbance is at its strongest allowed level, alone and all at once, in separate
environments.
"""

import resource
import runpy
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import typer
from numpy.typing import NDArray
from rich.box import MARKDOWN
from rich.console import Console
from rich.table import Table

import armctl
from armctl.core.arrays import Array
from armctl.disturbances import available
from armctl.envs.vector import TaskVectorEnv
from armctl.simulation.impacts import DEPTH
from armctl.tasks import (
    BridgeMovingTask,
    BridgeOutcome,
    BridgeTask,
    ReachMovingTask,
    ReachObstaclesTask,
    ReachTask,
    Task,
)

TESTS = Path(__file__).parents[1] / "tests"
BatchSteps = runpy.run_path(str(TESTS / "simulation" / "batch_steps.py"))["BatchSteps"]

ACTIONS = ("uniform", "bang-bang", "held", "walk", "push")
HOLD = 25
"""Control steps for which held extremes stay, on average."""


class _PlaysOn:
    """An arm whose episodes end by the time limit only."""

    def outcome(self: Any) -> NDArray[np.int8]:
        return np.zeros(self.n, dtype=np.int8)


class _Reach(_PlaysOn, ReachTask): ...


class _Moving(_PlaysOn, ReachMovingTask): ...


class _Obstacles(_PlaysOn, ReachObstaclesTask): ...


class _FallsOnly:
    """A bridge on which only falls end the episode."""

    def outcome(self: Any) -> NDArray[np.int8]:
        return np.where(self.state.fell, np.int8(BridgeOutcome.FELL), np.int8(BridgeOutcome.TIMEOUT))


class _Bridge(_FallsOnly, BridgeTask): ...


CONTROLS = ("position", "delta", "velocity", "torque")
ENVIRONMENTS: dict[str, tuple[type[Task], int, dict[str, Any], tuple[str, ...]]] = {
    "ArmReach-v0": (_Reach, 100, {}, CONTROLS),
    "ArmReachMoving-v0": (_Moving, 300, {}, CONTROLS),
    "ArmReachObstacles-v0": (_Obstacles, 200, {"solvable": False}, CONTROLS),
    "BridgeCross-v0": (_Bridge, 300, {"observation": "state"}, ("velocity",)),
    "BridgeCrossMoving-v0": (BridgeMovingTask, 600, {"observation": "state"}, ("velocity",)),
}
"""Task, time limit, options and control modes of each environment."""


class Meter:
    """The worst of each world of a task, (n,): every physics step counts, apart from those that are repeated."""

    def __init__(self, task: Any, misfitting: bool = False) -> None:
        self._task, self._simulation, self._batch = task, task.simulation, task.simulation._batch
        stepper = BatchSteps.take_over(task.simulation)
        self.limit_excess, self.penetration, self.speed_ratio, self.silent_resets = np.zeros((4, task.n))
        self._current = np.zeros((3, task.n))
        self._qpos, self._time, self._sensors = (
            self._simulation.array(name) for name in ("qpos", "time", "sensordata")
        )
        self._limits, self._speeds = task.joints.limits, task.joints.speeds
        model = self._simulation.model
        body_names = [model.body(model.geom_bodyid[i]).name for i in range(model.ngeom)]
        self._soft = {i for i, name in enumerate(body_names) if name.endswith("_wheel") or name.startswith("walker_")}
        self._overlapping: list[set[frozenset[int]]] = [set() for _ in range(task.n)]
        people = any(name.startswith("walker_") for name in body_names)
        self._any_depth = model.sensor(DEPTH).adr[0]
        self._depth = None if people or misfitting else self._any_depth
        self._tick, self._batch_step = stepper.tick, self._batch.step
        self._reached = self._time.copy()
        stepper.tick, self._batch.step = self._measured, self._one_by_one

    def began(self, ids: NDArray[np.int32]) -> None:
        """Note what overlaps at the start of episodes in worlds `ids`."""
        for i in ids if self._depth is None else ():
            contacts = self._simulation.data(int(i)).contact
            self._overlapping[i] = set(map(frozenset, contacts.geom[contacts.dist < 0].tolist()))

    def stepped(self, awake: NDArray[np.bool_]) -> None:
        """Do nothing."""

    def _measured(self, substeps: int, worlds: NDArray[np.int32]) -> None:
        self._current[:], end = 0.0, self._time[worlds] + substeps * self._simulation.model.opt.timestep
        self._tick(substeps, worlds)
        going_on = ~self._simulation.unstable[worlds]
        self.silent_resets[worlds] += going_on & (np.abs(self._time[worlds] - end) > 1e-6)
        self._measure()
        self._measure_depth()
        if self._depth is None:
            self._read_contacts()
        for worst, current in zip((self.limit_excess, self.speed_ratio, self.penetration), self._current, strict=True):
            worst[worlds[going_on]] = np.maximum(worst, current)[worlds[going_on]]

    def _one_by_one(self, ids: NDArray[np.int32] | None = None, nstep: int = 1, stage: int = 0) -> None:
        """Run `Batch.step`, measured before each physics step. Steps that are taken back do not count."""
        for k in range(nstep):
            self._current[:, self._time < self._reached] = 0.0
            self._measure()
            self._batch_step(ids, nstep=1, stage=stage if k == nstep - 1 else 0)
            self._reached = self._time.copy()
            self._measure_depth()

    def _measure(self) -> None:
        speed = (np.abs(np.nan_to_num(self._speeds, nan=np.inf)) / self._limits.speed).max(axis=1)
        self._current[1] = np.maximum(self._current[1], speed)
        if self._limits.position is not None:
            lowest, highest = self._limits.position
            excess = np.maximum(self._qpos - highest, lowest - self._qpos).max(axis=1)
            self._current[0] = np.fmax(self._current[0], excess)

    def _measure_depth(self) -> None:
        if self._depth is not None:
            self._current[2] = np.maximum(self._current[2], -self._sensors[:, self._depth])

    def _read_contacts(self) -> None:
        for i in np.flatnonzero(self._sensors[:, self._any_depth] < 0):
            contacts = self._simulation.data(int(i)).contact
            pairs = map(frozenset, contacts.geom.tolist())
            hard = [not self._soft & pair and pair not in self._overlapping[i] for pair in pairs]
            self._current[2, i] = -contacts.dist[hard].min(initial=0.0)


class Hostile:
    """Actions of all worlds: world i's are of the kind `ACTIONS[i % 5]`."""

    def __init__(self, env: TaskVectorEnv, rng: np.random.Generator) -> None:
        self._env, self._rng = env, rng
        self._low, self._high = (np.asarray(bound, dtype=float) for bound in self._bounds(env))
        n = env.num_envs
        self.kinds = np.arange(n) % len(ACTIONS)
        self._held, self._walk = self._extremes(), np.zeros((n, len(self._low)))

    def __call__(self) -> Array:
        """Return actions (n, k) within the bounds."""
        n, k = self._walk.shape
        change = self._rng.random(n) < 1 / HOLD
        self._held[change] = self._extremes()[change]
        self._walk = np.clip(self._walk + 0.2 * self._rng.standard_normal((n, k)), -1, 1)
        uniform = self._rng.uniform(-1, 1, (n, k))
        each = np.array((uniform, self._extremes(), self._held, self._walk, self._push()))
        chosen = each[self.kinds, np.arange(n)]
        return np.asarray(self._low + (chosen + 1) / 2 * (self._high - self._low))

    def _bounds(self, env: TaskVectorEnv) -> tuple[Any, Any]:
        return env.single_action_space.low, env.single_action_space.high

    def _extremes(self) -> Array:
        return self._rng.choice((-1.0, 1.0), (self._env.num_envs, len(self._low)))

    def _push(self) -> Array:
        """Push: arms move the hand down, as hard as it goes; rovers drive fast in a curve into the side."""
        task: Any = self._env.task
        if not isinstance(task, ReachTask):
            return np.column_stack((np.ones(self._env.num_envs), 0.15 * self._held[:, 1]))
        q = np.clip(np.nan_to_num(task.arm.joint_positions), -10, 10)
        down = -np.array([task._workspace.model.jacobian(each)[2] for each in q])
        return np.sign(down) + (down == 0)


@dataclass
class Row:
    """Row of the table."""

    env: str
    control: str
    disturbance: str
    actions: str
    steps: int
    episodes: int
    not_finite: int
    silent_resets: int
    unstable: int
    limit_excess: float
    penetration: float
    speed_ratio: float
    memory: float


def soak(
    env: str, control: str, steps: int, num_envs: int, seed: int, disturbances: dict[str, float], label: str
) -> Iterator[Row]:
    """Make `steps` control steps, and yield a row for each kind of actions."""
    task, max_steps, options, _ = ENVIRONMENTS[env]
    chosen = options | ({"control": control} if env.startswith("Arm") else {})
    num_envs = max(len(ACTIONS), min(num_envs, steps // max_steps // len(ACTIONS) * len(ACTIONS)))
    vec_env = TaskVectorEnv(
        num_envs,
        task=task,
        max_episode_steps=max_steps,
        autoreset_mode="same_step",
        disturbances=disturbances,
        **chosen,
    )
    meter, act = Meter(vec_env.task, "mismatch" in disturbances), Hostile(vec_env, np.random.default_rng(seed))
    vec_env.observers.append(meter)
    vec_env.reset(seed=seed)
    not_finite, unstable = np.zeros((2, num_envs))
    episodes = np.zeros(num_envs, dtype=int)
    turns = -(-steps // num_envs)
    memory = 0.0
    for turn in range(turns):
        observations, rewards, terminated, truncated, infos = vec_env.step(act())
        parts = observations.values() if isinstance(observations, dict) else (observations,)
        finite = np.isfinite(rewards)
        for part in parts:
            finite &= np.isfinite(part).reshape(num_envs, -1).all(axis=1)
        not_finite += ~finite
        final = infos.get("final_info", infos)
        unstable += (final["outcome_id"] == vec_env.outcomes.index("unstable")) & (terminated | truncated)
        episodes += terminated | truncated
        if turn == turns // 4:
            memory = _memory()
    memory = _memory() - memory
    vec_env.close()
    for kind, name in enumerate(ACTIONS):
        of_kind = act.kinds == kind
        yield Row(
            env, control, label, name, turns * int(of_kind.sum()), int(episodes[of_kind].sum()),
            int(not_finite[of_kind].sum()), int(meter.silent_resets[of_kind].sum()), int(unstable[of_kind].sum()),
            float(meter.limit_excess[of_kind].max()), float(meter.penetration[of_kind].max()),
            float(meter.speed_ratio[of_kind].max()), memory,
        )  # fmt: skip


def highest_levels(env: str) -> dict[str, float]:
    """Return the level of each disturbance that is farthest from the one that changes nothing."""
    task, _, options, _ = ENVIRONMENTS[env]
    specs = available(task.disturbances, TaskVectorEnv(1, task=task, **options).task)
    return {name: spec.strongest for name, spec in specs.items()}


def _memory() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _table(rows: list[Row], title: str) -> Table:
    table = Table(
        "environment", "control", "disturbance", "actions", "control steps", "episodes", "not finite", "silent resets",
        "unstable", "beyond joint limits, rad", "penetration, mm", "speed / limit", "memory, MB", title=title,
        title_justify="left", box=MARKDOWN,
    )  # fmt: skip
    for row in rows:
        limits = f"{row.limit_excess:.4f}" if row.env.startswith("Arm") else "-"
        table.add_row(
            row.env, row.control, row.disturbance, row.actions, f"{row.steps:,}", f"{row.episodes:,}",
            str(row.not_finite), str(row.silent_resets), str(row.unstable), limits, f"{1e3 * row.penetration:.2f}",
            f"{row.speed_ratio:.2f}", f"{row.memory:.0f}",
        )  # fmt: skip
    return table


def _merged(rows: list[Row]) -> Row:
    """Merge all kinds of actions into one row."""
    counts = {name: sum(getattr(row, name) for row in rows) for name in (
        "steps", "episodes", "not_finite", "silent_resets", "unstable",
    )}  # fmt: skip
    worst = {name: max(getattr(row, name) for row in rows) for name in (
        "limit_excess", "penetration", "speed_ratio", "memory",
    )}  # fmt: skip
    return Row(rows[0].env, rows[0].control, rows[0].disturbance, "all", **counts, **worst)


def main(
    steps: int = 1_000_000,
    env: str = "",
    control: str = "",
    disturbed: bool = False,
    seed: int = 0,
    worlds: int = 250,
    each: bool = False,
) -> None:
    """Measure, and print a table; with `--each`, a row for each kind of actions."""
    start, rows = time.perf_counter(), []
    for name in [name for name in ENVIRONMENTS if env in name]:
        controls = [item for item in ENVIRONMENTS[name][3] if control in item]
        highest = highest_levels(name) if disturbed else {}
        trials = [(f"{item} {level:g}", {item: level}) for item, level in highest.items()]
        trials += (
            [("all", highest), ("all, motors whole", highest | {"strength": 1.0})] if disturbed else [("none", {})]
        )
        for mode in controls:
            for label, levels in trials:
                share = steps // len(controls) // len(trials)
                results = list(soak(name, mode, share, worlds, seed, levels, label))
                rows += results if each else [_merged(results)]
                Console(stderr=True).print(rows[-1])
    Console(width=250).print(_table(rows, f"{steps:,} control steps per environment, seed {seed}"))
    print(f"armctl {armctl.__version__}, {(time.perf_counter() - start) / 60:.0f} minutes")


if __name__ == "__main__":
    typer.run(main)

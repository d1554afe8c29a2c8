"""Time of one decision of each kind beside its physical limit: bytes moved, flops, wake-ups, and measured operations.

    python benchmarks/limits.py [--seconds 1] [--rounds 5]

All is measured on one core, in turns, and the ratios are medians over the rounds: other work on the machine slows all
alike. A limit is the larger of flops by peak speed and bytes by bandwidth, and in addition the wake-ups, and what the
decision's method cannot do without, at its time in compiled code: physics steps, collision checks, iterations of a
solver. See `limit_model.py`; each function here and in `limit_experts.py` says what it counts.
"""

import multiprocessing
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import typer
from limit_experts import Costs, arm_plan, between_steps, bridge_plan, control, inverse_kinematics
from limit_model import Decision, Work, network_work, num_bytes
from one_core import Measure, machine_of, pin_to_one_core, shared, speed_table, speeds, timed
from printing import markdown_table, progress, show
from throughput import batched, raw, single

from armctl.envs import EpisodeVectorEnv, make_worlds
from armctl.policies import Policy, make_policy
from armctl.policies.names import agent_cards
from armctl.runtime.isolation import close, isolated
from armctl.runtime.policy_server import serve_policy

ARM, AMONG_BOXES, BRIDGE = "armctl/ArmReach-v0", "armctl/ArmReachObstacles-v0", "armctl/BridgeCross-v0"
STEPS = {ARM: "`mj_step` of the arm", BRIDGE: "`mj_step` of the bridge"}
OPERATOR = "operator of a network"
WORLDS, OPERATORS = 256, 200
BLOCK, MANY = 10, 100
"""Decisions of a network that are timed together: here, and in another process."""
BOX_FLOPS = 22
"""Flops of a ray and a box: 6 differences, 6 products, 10 comparisons."""


def steps(costs: Costs) -> Iterator[Decision]:
    """Yield control steps: physics, state in and out, action, observation, and one box for each pixel's ray."""
    for env, name in ((ARM, "reach"), (BRIDGE, "bridge with camera")):
        costs[STEPS[env]], worlds = step_time(raw(env, 1, True)), make_worlds(env, 1)
        task, (observations, _) = worlds.task, worlds.reset(seed=0)
        image = observations["image"] if isinstance(observations, dict) else np.zeros(0)
        moved = 2 * task.simulation.live_arrays["state"].nbytes + num_bytes(observations, worlds.idle_action)
        work = Work(BOX_FLOPS * image.size, moved, operations={STEPS[env]: task.substeps})
        for way, rate in (("`gym.make`", single(env)), (f"{WORLDS} worlds", batched(env, WORLDS))):
            yield Decision(f"step: {name}, {way}", shared(step_time(rate), 1 / task.substeps), work)
    camera = Work(BOX_FLOPS * image.size, num_bytes(image))
    yield Decision("observation: bridge with camera", timed(lambda _: task.observe(), BLOCK), camera)


def step_time(rate: Measure) -> Measure:
    """Measure processor seconds of a physics step, of which `rate` makes so many per second."""

    def run(seconds: float) -> float:
        begin, processor = time.perf_counter(), time.process_time()
        per_second = rate(seconds)
        return (time.process_time() - processor) / (time.perf_counter() - begin) / per_second

    return run


def networks(costs: Costs) -> Iterator[Decision]:
    """Yield decisions of networks: weights, observations and actions."""
    costs[OPERATOR] = operator()
    for name, env, num_envs in (
        ("reach_ppo", ARM, 1), ("reach_ppo", ARM, WORLDS), ("obstacles_plan_bc", AMONG_BOXES, 1),
        ("bridge_ppo", BRIDGE, 1), ("bridge_ppo", BRIDGE, WORLDS),
    ):  # fmt: skip
        worlds = make_worlds(env, num_envs)
        policy, work = make_policy(name, worlds, policy_seed=0), work_of(name, worlds)
        label = f"network: `{name}` ({len(graph_of(name).graph.node)} operators)"
        yield Decision(f"{label}, {num_envs} at once", shared(timed(acting(policy, worlds), BLOCK), num_envs), work)
        if name == "reach_ppo" and num_envs == 1:
            worlds = make_worlds(env, 1)
            decide = between_steps(make_policy(name, worlds, policy_seed=0), worlds)
            yield Decision(f"{label}, between physics steps", decide, work)


def operator() -> Measure:
    """Measure an operator of a graph that has many, each of four numbers."""
    nodes = [onnx.helper.make_node("Mul", [f"x{i}", "x0"], [f"x{i + 1}"]) for i in range(OPERATORS)]
    ends = [
        onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [4]) for name in ("x0", nodes[-1].output[0])
    ]
    graph = onnx.helper.make_graph(nodes, "chain", ends[:1], ends[1:])
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=8)
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    return shared(timed(lambda _: session.run(None, {"x0": np.ones(4, np.float32)}), BLOCK), OPERATORS)


def graph_of(name: str) -> onnx.ModelProto:
    return onnx.load(agent_cards()[name].with_suffix(".onnx"))


def work_of(name: str, worlds: EpisodeVectorEnv) -> Work:
    moved = num_bytes(worlds.single_observation_space.sample(), worlds.single_action_space.sample())
    return network_work(graph_of(name), moved, worlds.num_envs)


def acting(policy: Policy, worlds: EpisodeVectorEnv) -> Callable[[int], object]:
    """Return decisions of a policy at the first observations."""
    observations, _ = worlds.reset(seed=0)
    policy.reset(np.arange(worlds.num_envs, dtype=np.int32))
    return lambda _: policy.act(observations)


def other_processes(stack: ExitStack) -> Iterator[Decision]:
    """Yield decisions of a network in another process: two wake-ups, and messages written and read."""
    worlds = make_worlds(ARM, 1)
    inside = work_of("reach_ppo", worlds)
    sizes = num_bytes(worlds.single_observation_space.sample(), worlds.single_action_space.sample())
    work = replace(inside, wake_ups=2, bytes=inside.bytes + 2 * sizes)
    policy: Any = isolated("reach_ppo", worlds, "reach_ppo", 0)
    stack.callback(close, [policy])
    clock = clock_with(policy._process._process.pid)
    yield Decision("other process: `--isolate`", timed(acting(policy, worlds), MANY, clock), work)
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe()
    server = context.Process(target=serve_policy, args=("reach_ppo", ARM, {}, "127.0.0.1", 0, sender.send), daemon=True)
    server.start()
    stack.callback(server.kill)
    served = make_policy(f"ws://127.0.0.1:{receiver.recv()}", worlds, policy_seed=0)
    stack.callback(close, [served])
    decide = timed(acting(served, worlds), MANY, clock_with(server.pid))
    yield Decision("other process: `armctl serve`", decide, work)


def clock_with(process: int | None) -> Callable[[], float]:
    """Return a clock of the processor time of this process and of another one, s."""
    threads = Path(f"/proc/{process}/task")

    def clock() -> float:
        nanoseconds = sum(int(path.read_text().split()[0]) for path in threads.glob("*/schedstat"))
        return time.process_time() + 1e-9 * nanoseconds

    return clock


def main(seconds: float = 1.0, rounds: int = 5) -> None:
    """Measure, and print tables."""
    with ExitStack() as stack:
        costs = speeds()
        kinds = (steps, inverse_kinematics, control, bridge_plan, arm_plan, networks)
        decisions = [decision for kind in kinds for decision in kind(costs)] + list(other_processes(stack))
        times: dict[str, list[float]] = {name: [] for name in (*costs, *(each.name for each in decisions))}
        measures = costs | {each.name: each.measure for each in decisions}
        for measure in measures.values():
            measure(0.05)  # compiles
        for _ in progress(range(rounds)):
            for name, measure in measures.items():
                times[name].append(measure(seconds))
    machines = [machine_of({name: times[name][i] for name in costs}) for i in range(rounds)]
    show(speed_table({name: float(np.median(times[name])) for name in costs}))
    table = markdown_table(
        "a decision", "us", "flops", "bytes", "wake-ups", "operations", "limit, us", "times the limit"
    )
    for decision in decisions:
        work, measured = decision.work, times[decision.name]
        limits = [machine.limit(work) for machine in machines]
        operations = ", ".join(f"{count:,.0f} x {name}" for name, count in work.operations.items())
        counts = (f"{work.flops:,.0f}", f"{work.bytes:,.0f}", str(work.wake_ups), operations)
        duration, limit = (f"{1e6 * np.median(values):,.1f}" for values in (measured, limits))
        table.add_row(decision.name, duration, *counts, limit, f"{np.median(np.divide(measured, limits)):,.1f}")
    show(table)


if __name__ == "__main__":
    pin_to_one_core()
    typer.run(main)

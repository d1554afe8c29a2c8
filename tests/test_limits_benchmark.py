"""`benchmarks/limits.py` counts the work of decisions right, and computes the limit by it."""

import runpy
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import TensorProto, helper

from armctl.policies.names import agent_cards

FOLDER = Path(__file__).parents[1] / "benchmarks"
model = runpy.run_path(str(FOLDER / "limit_model.py"))
Work, Machine = model["Work"], model["Machine"]
MACHINE = Machine({"float32": 100.0, "float64": 50.0}, {1000: 20.0, 4000: 10.0}, wake_up=7.0, operations={"check": 0.5})


def network(nodes, inputs, outputs, weights):
    """Return an ONNX graph of one input and one output with a row for each world."""
    rng = np.random.default_rng(0)
    arrays = [
        onnx.numpy_helper.from_array(rng.random(shape).astype(np.float32), name) for name, shape in weights.items()
    ]
    values = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["worlds", *shape])
        for name, shape in (("observation", inputs), ("action", outputs))
    ]
    graph = helper.make_graph(nodes, "network", values[:1], values[1:], arrays)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])


def perceptron():
    nodes = [
        helper.make_node("Gemm", ["observation", "w1", "b1"], ["h"], transB=1),
        helper.make_node("Tanh", ["h"], ["t"]),
        helper.make_node("MatMul", ["t", "w2"], ["action"]),
    ]
    return network(nodes, [12], [6], {"w1": (64, 12), "b1": (64,), "w2": (64, 6)})


def test_the_limit_is_the_longer_of_arithmetic_and_memory():
    assert MACHINE.limit(Work(flops=500)) == 10
    assert MACHINE.limit(Work(flops=500, precision="float32")) == 5
    assert MACHINE.limit(Work(flops=500, bytes=100)) == 10
    assert MACHINE.limit(Work(flops=500, bytes=800)) == 40


@pytest.mark.parametrize(("size", "seconds"), [(1000, 50), (1001, 100.1), (4000, 400), (8000, 800)])
def test_bytes_are_as_fast_as_the_memory_that_holds_them(size, seconds):
    assert MACHINE.limit(Work(bytes=size)) == pytest.approx(seconds)


def test_wake_ups_and_operations_overlap_with_nothing():
    assert MACHINE.limit(Work(flops=500, wake_ups=2, operations={"check": 4})) == 10 + 14 + 2


def test_an_operation_that_was_not_measured_is_an_error():
    with pytest.raises(KeyError, match="unheard"):
        MACHINE.limit(Work(operations={"unheard": 1}))


@given(
    work=st.builds(Work, flops=st.floats(0, 1e6), bytes=st.floats(0, 900), wake_ups=st.integers(0, 5)),
    part=st.sampled_from(["flops", "bytes", "wake_ups"]),
)
def test_more_work_is_never_faster(work, part):
    more = replace(work, **{part: getattr(work, part) + 1})
    assert MACHINE.limit(more) >= MACHINE.limit(work) >= 0


def test_products_of_a_network_are_counted():
    work = model["network_work"](perceptron(), inputs=48 + 24, num_envs=1)
    assert work.flops == 2 * (12 * 64 + 64 * 6)
    assert work.bytes == 4 * (12 * 64 + 64 + 64 * 6) + 48 + 24


def test_worlds_share_the_weights_and_nothing_else():
    one, many = (model["network_work"](perceptron(), inputs=72, num_envs=n) for n in (1, 256))
    assert many.flops == one.flops
    assert 256 * (many.bytes - 72) == one.bytes - 72


def test_a_convolution_is_a_product_at_each_pixel():
    conv = helper.make_node("Conv", ["observation", "w"], ["action"], kernel_shape=[3, 3])
    assert model["multiplications"](network([conv], [2, 8, 6], [5, 6, 4], {"w": (5, 2, 3, 3)})) == 5 * 6 * 4 * 2 * 9


def test_recurrent_layers_are_refused():
    gru = helper.make_node("GRU", ["observation", "w", "r"], ["y", "action"], hidden_size=4)
    with pytest.raises(ValueError, match="GRU are not counted"):
        model["multiplications"](network([gru], [1, 3], [1, 4], {"w": (1, 12, 3), "r": (1, 12, 4)}))


@pytest.mark.parametrize("name", ["reach_ppo", "bridge_state_ppo"])
def test_an_agent_of_dense_layers_multiplies_once_by_each_weight(name):
    graph = onnx.load(agent_cards()[name].with_suffix(".onnx"))
    numbers = {tensor.name: np.prod(tensor.dims) for tensor in graph.graph.initializer}
    dense = sum(numbers[node.input[1]] for node in graph.graph.node if node.op_type == "Gemm")
    assert model["multiplications"](graph) == dense


def test_a_closed_form_checks_each_branch():
    work = model["closed_form_work"](6, 8, "angle")
    assert work.flops == 8 * 6 * 63
    assert work.operations == {"angle": 8 * 6 * 3}


@pytest.mark.slow
def test_all_decisions_are_measured(monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(FOLDER))
    monkeypatch.setenv("COLUMNS", "300")
    runpy.run_path(str(FOLDER / "limits.py"))["main"](seconds=0.01, rounds=1)
    rows = [line.split("|")[1:-1] for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    decisions = [row for row in rows if len(row) == 8 and row[-1].strip(" -").replace(",", "")[:1].isdigit()]
    assert len(decisions) > 15
    assert all(float(row[6].replace(",", "")) > 0 for row in decisions)
    for name in (
        "arm_planning",
        "limit_experts",
        "limit_model",
        "mpc",
        "one_core",
        "planning",
        "printing",
        "throughput",
    ):
        sys.modules.pop(name, None)

"""ONNX graphs: what is refused, and that a world's outputs do not depend on the number of worlds."""

import itertools
import time
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper

from armctl.agents import graph, read_card
from armctl.agents.graph import OPERATORS, load_graph
from armctl.core.errors import AgentFileError

SHIPPED = sorted(Path(str(resources.files("armctl.rl.agents"))).glob("*.json"))
BATCHES = (1, 2, 3, 7, 50, 64)
N = 193
"""Worlds: a multiple of no batch but the smallest, so that the last batches are short too."""


def model_of(nodes, *, constants=(), shape=(6,), result=(6,), kind=TensorProto.FLOAT, out=TensorProto.FLOAT, opset=20):
    graph = helper.make_graph(
        nodes,
        "graph",
        [helper.make_tensor_value_info("observation", kind, ["worlds", *shape])],
        [helper.make_tensor_value_info("action", out, result and ["worlds", *result])],
        [numpy_helper.from_array(value, name) for name, value in dict(constants).items()],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=10)


def saved(model, tmp_path):
    path = tmp_path / "agent.onnx"
    path.write_bytes(model.SerializeToString())
    return path


def check_same_outputs(graph, arrays):
    """The same rows alone, and in batches of several sizes, bit for bit."""
    together = graph.run(arrays)
    for batch in BATCHES:
        parts = [
            graph.run({name: values[i : i + batch] for name, values in arrays.items()}) for i in range(0, N, batch)
        ]
        for output, expected in zip(zip(*parts, strict=True), together, strict=True):
            np.testing.assert_array_equal(np.concatenate(output), expected, err_msg=f"batches of {batch}")


@pytest.mark.one_case
@pytest.mark.parametrize("card", SHIPPED, ids=lambda path: path.stem)
def test_a_shipped_agent_acts_alike_in_any_number_of_worlds(card):
    described = read_card(card)
    observed = described.observation_shape
    shapes = (observed if isinstance(observed, dict) else {"observation": observed}) | described.memory
    rng = np.random.default_rng(0)
    arrays = {name: rng.uniform(-3, 3, (N, *shape)).astype(np.float32) for name, shape in shapes.items()}
    check_same_outputs(
        load_graph(card.with_suffix(".onnx")), {name: abs(v) if name == "image" else v for name, v in arrays.items()}
    )


RNG = np.random.default_rng(1)
WIDE = {"w": RNG.normal(size=(6, 130)).astype(np.float32)}
ONE = {"w": np.array([1.7], dtype=np.float32)}
AXIS = {"w": np.array([1], dtype=np.int64)}
SCALE = {"w": RNG.uniform(0.5, 2, 6).astype(np.float32)}
KERNEL = {"w": RNG.normal(size=(5, 2, 3)).astype(np.float32)}


def recurrent(name, gates):
    sizes = {"w": (1, gates * 8, 6), "r": (1, gates * 8, 8)}
    constants = {key: RNG.normal(size=size).astype(np.float32) for key, size in sizes.items()} | {
        "axis": np.array([0], dtype=np.int64)
    }
    return (
        [
            helper.make_node("Unsqueeze", ["observation", "axis"], ["sequence"]),
            helper.make_node(name, ["sequence", "w", "r"], ["", "last"], hidden_size=8),
            helper.make_node("Squeeze", ["last", "axis"], ["action"]),
        ],
        constants,
        (6,),
    )


def simple(name, constants=(), shape=(6,), **attributes):
    return [helper.make_node(name, ["observation", *dict(constants)], ["action"], **attributes)], constants, shape


NUMERIC = {
    name: simple(name)
    for name in (
        "Abs", "Acos", "Atan", "Ceil", "Cos", "Elu", "Erf", "Exp", "Floor", "Gelu", "HardSigmoid", "HardSwish",
        "LeakyRelu", "Mish", "Neg", "Reciprocal", "Relu", "Round", "Selu", "Sigmoid", "Sign", "Sin", "Softplus",
        "Softsign", "Tan", "Tanh", "ThresholdedRelu",
    )
}  # fmt: skip
NUMERIC |= {f"{name} of one number": simple(name, shape=(1,)) for name in ("Cos", "Elu", "Sin", "Softplus", "Tanh")}
NUMERIC |= {name: simple(name, axis=1) for name in ("Softmax", "LogSoftmax")}
NUMERIC |= {
    name: simple(name, AXIS)
    for name in (
        "ReduceL1", "ReduceL2", "ReduceLogSumExp", "ReduceMax", "ReduceMean", "ReduceMin", "ReduceProd", "ReduceSum",
        "ReduceSumSquare",
    )
}  # fmt: skip
NUMERIC |= {
    "Gemm": simple("Gemm", WIDE), "MatMul": simple("MatMul", WIDE), "Pow": simple("Pow", ONE),
    "Add": simple("Add", ONE), "Mul": simple("Mul", ONE), "Div": simple("Div", ONE), "PRelu": simple("PRelu", ONE),
    "LayerNormalization": simple("LayerNormalization", SCALE),
    "Conv": simple("Conv", KERNEL, (2, 9)), "AveragePool": simple("AveragePool", (), (2, 9), kernel_shape=[3]),
    "GlobalAveragePool": simple("GlobalAveragePool", (), (2, 9)),
    "BatchNormalization": simple("BatchNormalization", dict.fromkeys("wxyz", SCALE["w"])),
    "LSTM": recurrent("LSTM", 4), "GRU": recurrent("GRU", 3), "RNN": recurrent("RNN", 1),
}  # fmt: skip


@pytest.mark.one_case
@pytest.mark.parametrize("name", NUMERIC)
def test_an_operator_rounds_alike_in_any_number_of_worlds(name, tmp_path):
    nodes, constants, shape = NUMERIC[name]
    graph = load_graph(saved(model_of(nodes, constants=constants, shape=shape, result=None), tmp_path))
    check_same_outputs(graph, {"observation": np.random.default_rng(0).uniform(-3, 3, (N, *shape)).astype(np.float32)})


@pytest.mark.parametrize("name", ["Log", "Sqrt"])
def test_an_operator_of_positive_numbers_rounds_alike(name, tmp_path):
    graph = load_graph(saved(model_of([helper.make_node(name, ["observation"], ["action"])]), tmp_path))
    check_same_outputs(graph, {"observation": np.random.default_rng(0).uniform(0.1, 9, (N, 6)).astype(np.float32)})


def test_what_rounds_is_tried():
    """The other operators of agents choose, compare, move or count numbers, and do not round."""
    exact = {
        "And", "ArgMax", "ArgMin", "Cast", "Clip", "Concat", "Constant", "ConstantOfShape", "Equal", "Expand",
        "Flatten", "Gather", "GatherElements", "Greater", "GreaterOrEqual", "Identity", "IsNaN", "Less", "LessOrEqual",
        "Max", "MaxPool", "Mean", "Min", "Not", "OneHot", "Or", "Pad", "Range", "Reshape", "Shape", "Slice", "Split",
        "Squeeze", "Sub", "Sum", "Tile", "TopK", "Transpose", "Trilu", "Unsqueeze", "Where", "Xor",
    }  # fmt: skip
    assert {name.partition(" ")[0] for name in NUMERIC} | {"Log", "Sqrt"} | exact == OPERATORS


def identity(name="Identity", **attributes):
    return helper.make_node(name, ["observation"], ["action"], **attributes)


def value(name, kind=TensorProto.FLOAT, shape=None):
    return helper.make_tensor_value_info(name, kind, shape)


def with_loop():
    """Counts for ever."""
    body = helper.make_graph(
        [helper.make_node("Identity", ["on"], ["again"]), helper.make_node("Identity", ["seen"], ["left"])],
        "body",
        [value("i", TensorProto.INT64, []), value("on", TensorProto.BOOL, []), value("seen")],
        [value("again", TensorProto.BOOL, []), value("left")],
    )
    return model_of(
        [helper.make_node("Loop", ["times", "on", "observation"], ["action"], body=body)],
        constants={"times": np.array(2**62), "on": np.array(True)},
    )


def misfitting():
    product = helper.make_node("MatMul", ["observation", "w"], ["action"])
    return model_of([product], constants={"w": np.eye(5, dtype=np.float32)})


def long():
    names = ["observation", *(f"x{i}" for i in range(graph.MAX_NODES)), "action"]
    return model_of([helper.make_node("Relu", [a], [b]) for a, b in itertools.pairwise(names)])


def outside():
    model = model_of([helper.make_node("Add", ["observation", "w"], ["action"])], constants=SCALE)
    (tensor,) = model.graph.initializer
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", "../../../etc/passwd"
    return model


def outside_in_an_attribute():
    inside = outside().graph.initializer[0]
    nodes = [
        helper.make_node("Constant", [], ["w"], value=inside),
        helper.make_node("Add", ["observation", "w"], ["action"]),
    ]
    return model_of(nodes)


def huge(numbers):
    return model_of(
        [
            helper.make_node("ConstantOfShape", ["size"], ["zeros"]),
            helper.make_node("ReduceSum", ["zeros"], ["sum"], keepdims=0),
            helper.make_node("Add", ["observation", "sum"], ["action"]),
        ],
        constants={"size": np.array(numbers, dtype=np.int64)},
    )


def sized_by_its_input():
    return model_of(
        [
            helper.make_node("Cast", ["observation"], ["whole"], to=TensorProto.INT64),
            helper.make_node("Reshape", ["whole", "flat"], ["size"]),
            helper.make_node("ConstantOfShape", ["size"], ["zeros"]),
            helper.make_node("ReduceSum", ["zeros"], ["sum"], keepdims=0),
            helper.make_node("Add", ["observation", "sum"], ["action"]),
        ],
        constants={"flat": np.array([-1], dtype=np.int64)},
    )


def working_on_constants(name, shapes, **attributes):
    """What constant folding would compute before anything else."""
    constants = {f"c{i}": np.zeros(1, dtype=np.float32) for i in range(len(shapes))}
    constants |= {f"s{i}": np.array(shape, dtype=np.int64) for i, shape in enumerate(shapes)}
    nodes = [helper.make_node("Expand", [f"c{i}", f"s{i}"], [f"x{i}"]) for i in range(len(shapes))]
    nodes.append(helper.make_node(name, [f"x{i}" for i in range(len(shapes))], ["product"], **attributes))
    nodes.append(helper.make_node("ReduceMax", ["product"], ["largest"], keepdims=0))
    nodes.append(helper.make_node("Add", ["observation", "largest"], ["action"]))
    return model_of(nodes, constants=constants)


def dividing(divisor, kind=np.int32):
    """Divides by its own observation, or by a constant: by 0, the processor ends the process."""
    nodes = [
        helper.make_node("Cast", ["observation"], ["whole"], to=helper.np_dtype_to_tensor_dtype(np.dtype(kind))),
        helper.make_node("Div", ["whole", "whole" if divisor is None else "d"], ["ratio"]),
        helper.make_node("Cast", ["ratio"], ["action"], to=TensorProto.FLOAT),
    ]
    return model_of(nodes, constants={"d": np.array(divisor or 0, kind)})


def with_function():
    model = model_of([helper.make_node("Twice", ["observation"], ["action"], domain="own")])
    opsets = [helper.make_opsetid("", 20)]
    model.functions.append(
        helper.make_function("own", "Twice", ["x"], ["y"], [helper.make_node("Add", ["x", "x"], ["y"])], opsets)
    )
    model.opset_import.append(helper.make_opsetid("own", 1))
    return model


def of_another_domain():
    model = model_of([identity("Gelu", domain="com.microsoft")])
    model.opset_import.append(helper.make_opsetid("com.microsoft", 1))
    return model


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (with_loop, "do not use the operator 'Loop'"),
        (lambda: model_of([identity("Scan")]), "'Scan'"),
        (lambda: model_of([identity("If")]), "'If'"),
        (lambda: model_of([identity("Idendity")]), "Did you mean 'Identity'"),
        (with_function, "no functions"),
        (of_another_domain, "'com.microsoft.Gelu'"),
        (outside, "in another file"),
        (outside_in_an_attribute, "in another file"),
        (lambda: huge([10**6, 10**6]), "more than 50,000,000"),
        (lambda: huge([2**62, 4]), "more than 50,000,000|do not fit"),
        (sized_by_its_input, "not known beforehand|do not fit"),
        (misfitting, "do not fit"),
        (lambda: working_on_constants("MatMul", [(2000, 2000), (2000, 2000)]), "multiplications"),
        (lambda: working_on_constants("Conv", [(1, 9, 900, 900), (9, 9, 300, 300)]), "multiplications"),
        (lambda: working_on_constants("MaxPool", [(1, 9, 900, 900)], kernel_shape=[400, 400]), "multiplications"),
        (
            lambda: working_on_constants("RNN", [(9000, 1, 40), (1, 500, 40), (1, 500, 500)], hidden_size=500),
            "multiplications",
        ),
        (long, "nodes"),
        *((lambda divisor=divisor: dividing(divisor), "divides whole numbers") for divisor in (None, 0, -1)),
        (lambda: model_of([identity()], shape=("any",)), "not known beforehand"),
    ],
)
def test_what_is_not_run(make, says, tmp_path):
    started = time.monotonic()
    with pytest.raises(AgentFileError, match=says):
        load_graph(saved(make(), tmp_path))
    assert time.monotonic() - started < graph.LONGEST_TRIAL


def test_a_file_that_is_too_large(tmp_path):
    path = tmp_path / "agent.onnx"
    with path.open("wb") as file:
        file.truncate(graph.LARGEST_FILE + 1)
    with pytest.raises(AgentFileError, match="bytes, more than"):
        load_graph(path)


@pytest.mark.slow
def test_a_graph_that_is_too_slow(tmp_path, monkeypatch):
    monkeypatch.setattr(graph, "LONGEST_TRIAL", 0.02)
    monkeypatch.setattr(graph, "MAX_WORK", 10**12)
    size = 1500
    nodes = [helper.make_node("Gemm", [f"x{i}" if i else "observation", "w"], [f"x{i + 1}"]) for i in range(300)]
    nodes.append(helper.make_node("Identity", ["x300"], ["action"]))
    weights = {"w": np.eye(size, dtype=np.float32)}
    with pytest.raises(AgentFileError, match="takes more than"):
        load_graph(saved(model_of(nodes, constants=weights, shape=(size,), result=(size,)), tmp_path))


@pytest.mark.parametrize(("divisor", "kind"), [(2, np.int32), (2, np.int64), (None, np.float64), (0, np.float32)])
def test_other_divisions_are_run(divisor, kind, tmp_path):
    graph = load_graph(saved(dividing(divisor, kind), tmp_path))
    result = graph.run({"observation": np.full((2, 6), 7, np.float32)})[0]
    assert (result == {2: 3.0, None: 1.0, 0: np.inf}[divisor]).all()


def test_what_is_acceptable_computes(tmp_path):
    graph = load_graph(saved(model_of([helper.make_node("Sin", ["observation"], ["action"])]), tmp_path))
    given = np.linspace(-9, 9, 12).astype(np.float32).reshape(2, 6)
    np.testing.assert_allclose(graph.run({"observation": given})[0], np.sin(given), atol=1e-6)


@pytest.mark.parametrize(("size", "first", "ends"), [(-1, 0, 6), (0, 0, 6), (6, 3, 3), (6, 3, 2)])
@pytest.mark.parametrize("step", [1, -1])
def test_slices_of_nothing_are_refused(tmp_path, size, first, ends, step):
    """Inferring their shapes ended the process."""
    nodes = [
        helper.make_node("Slice", ["observation", "first", "ends", "axis"], ["part"]),
        helper.make_node("Slice", ["part", "ends", "first", "axis", "step"], ["action"]),
    ]
    numbers = {"first": first, "ends": ends, "axis": 1, "step": step}
    constants = {name: np.array([number]) for name, number in numbers.items()}
    path = saved(model_of(nodes, constants=constants, shape=(size,), result=None), tmp_path)
    with pytest.raises(AgentFileError, match=r"a dimension is empty or unknown|shapes do not fit"):
        load_graph(path)

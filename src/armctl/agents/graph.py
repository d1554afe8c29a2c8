"""An agent's ONNX graph: what is accepted from a stranger, and what makes it act alike in any number of worlds.

A graph is data: it has standard operators without control flow, all of its numbers are in its own file, and the sizes
of all arrays are known beforehand. It runs in this process: what would end the process is refused by its operators,
since a trial in another process would show only what happens with the trial's numbers.
"""

import functools
import math
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
from numpy.typing import NDArray
from onnx import AttributeProto, GraphProto, ModelProto, NodeProto, TensorProto, ValueInfoProto

from armctl.core.errors import AgentFileError, nearest
from armctl.core.files import bounded_bytes

DTYPES = {
    "tensor(float)": np.float32, "tensor(double)": np.float64, "tensor(bool)": np.bool_, "tensor(uint8)": np.uint8,
    "tensor(int8)": np.int8, "tensor(int16)": np.int16, "tensor(int32)": np.int32, "tensor(int64)": np.int64,
}  # fmt: skip
"""NumPy's types for onnxruntime's."""
LARGEST_FILE = 2**28
"""Bytes."""
MAX_NODES = 10_000
MAX_NUMBERS = 50_000_000
"""Limit on the numbers in all arrays that a graph takes and computes for two worlds."""
MAX_SLICES = 100
LARGEST_SIZES = 10_000
"""Bytes of an array that may be sizes of others. The numbers in larger ones do not matter to sizes."""
MAX_WORK = 2_000_000_000
"""Multiplications in products, convolutions and recurrent layers for two worlds."""
LONGEST_TRIAL = 10.0
"""s, of the first control steps."""
TRIED_WORLDS = 5
"""More than onnxruntime computes together, so that their outputs come from a batch of another size than one world's."""
MAX_KEPT = 16
"""Graphs that a process keeps, those that it has used last."""
ROUNDING = 1e-3
"""Limit on relative differences between outputs that count as alike, whatever the processor."""

OPERATORS = frozenset({
    "Abs", "Acos", "Add", "And", "ArgMax", "ArgMin", "Atan", "AveragePool", "BatchNormalization", "Cast", "Ceil",
    "Clip", "Concat", "Constant", "ConstantOfShape", "Conv", "Cos", "Div", "Elu", "Equal", "Erf", "Exp", "Expand",
    "Flatten", "Floor", "GRU", "Gather", "GatherElements", "Gelu", "Gemm", "GlobalAveragePool", "Greater",
    "GreaterOrEqual", "HardSigmoid", "HardSwish", "Identity", "IsNaN", "LSTM", "LayerNormalization", "LeakyRelu",
    "Less", "LessOrEqual", "Log", "LogSoftmax", "MatMul", "Max", "MaxPool", "Mean", "Min", "Mish", "Mul", "Neg",
    "Not", "OneHot", "Or", "PRelu", "Pad", "Pow", "RNN", "Range", "Reciprocal", "ReduceL1", "ReduceL2",
    "ReduceLogSumExp", "ReduceMax", "ReduceMean", "ReduceMin", "ReduceProd", "ReduceSum", "ReduceSumSquare", "Relu",
    "Reshape", "Round", "Selu", "Shape", "Sigmoid", "Sign", "Sin", "Slice", "Softmax", "Softplus", "Softsign",
    "Split", "Sqrt", "Squeeze", "Sub", "Sum", "Tan", "Tanh", "ThresholdedRelu", "Tile", "TopK", "Transpose", "Trilu",
    "Unsqueeze", "Where", "Xor",
})  # fmt: skip
"""Operators of agents: without control flow, and for each world alone whatever the number of worlds."""
FLOATS = {TensorProto.FLOAT, TensorProto.DOUBLE, TensorProto.FLOAT16, TensorProto.BFLOAT16}
SAME_SIZE = {"Flatten", "Identity", "Reshape", "Squeeze", "Transpose", "Unsqueeze"}
"""Operators whose result has as many numbers as their first input."""
MIXING = {"ReduceMean", "ReduceSum"}
"""Operators that onnxruntime rounds by the number of worlds. With one of these, each world is computed alone."""
TOGETHER = 4
"""Numbers that onnxruntime computes with one instruction. It rounds a rest of fewer numbers differently."""


class AgentGraph:
    """A checked graph, ready to run. Raises `AgentFileError` for a file that is not acceptable."""

    def __init__(self, path: Path, content: bytes) -> None:
        self._path = path
        model = _model(path, content)
        _check_operators(model, path)
        self.numbers = _constants(model, path)
        """Its constants, by name."""
        size = _check_sizes(model, self.numbers, path)
        self._batch = max(TOGETHER, MAX_NUMBERS // max(size, 1) * TOGETHER)
        """Worlds that are computed at once: more would take more memory than the limits allow."""
        if any(node.op_type in MIXING for node in model.graph.node):
            self._batch = 1
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.log_severity_level = 4
        try:
            self._session = onnxruntime.InferenceSession(
                model.SerializeToString(),
                options,
                ["CPUExecutionProvider"],
                disabled_optimizers=["ConstantFolding"],  # it computes, and without an end
            )
        except Exception as error:  # onnxruntime raises many kinds of exceptions for broken files
            raise _refused(path, f"onnxruntime cannot run it: {error}") from error
        self.dtypes = {value.name: DTYPES.get(value.type) for value in self._session.get_inputs()}
        """Types of the inputs, by name."""
        self.inputs = {value.name: list(value.shape[1:]) for value in self._session.get_inputs()}
        """Shapes of one world's inputs, by name."""
        self._names = [value.name for value in self._session.get_outputs()]
        if None in (*self.dtypes.values(), *(DTYPES.get(value.type) for value in self._session.get_outputs())):
            raise _refused(path, f"its inputs and outputs are to be one of {', '.join(DTYPES)}")
        self.outputs = dict(zip(self._names, self._tried_shapes(), strict=True))
        """Shapes of one world's outputs, by name, in their order."""

    def run(self, arrays: dict[str, NDArray[Any]], **options: Any) -> list[NDArray[Any]]:
        """Return the outputs (n, ...) for the inputs (n, ...). A world's outputs do not depend on other worlds."""
        num_envs = len(next(iter(arrays.values())))
        if num_envs > self._batch:
            starts = range(0, num_envs, self._batch)
            parts = [{name: values[i : i + self._batch] for name, values in arrays.items()} for i in starts]
            outputs = [self.run(part, **options) for part in parts]
            return [np.concatenate(batches) for batches in zip(*outputs, strict=True)]
        if missing := -num_envs % TOGETHER:
            arrays = {
                name: np.concatenate((values, values[-1:].repeat(missing, axis=0))) for name, values in arrays.items()
            }
        computed = [np.asarray(values) for values in self._session.run(self._names, arrays, **options)]
        if any(values.shape[:1] != (num_envs + missing,) for values in computed):
            raise ValueError("an output does not have a row for each world")
        return [values[:num_envs] for values in computed]

    def _tried_shapes(self) -> list[list[int]]:
        """Make a control step of some worlds, together, permuted and alone, and return the shapes of one's outputs."""
        rng = np.random.default_rng(0)
        arrays = {
            name: rng.uniform(0, 1 if np.issubdtype(kind, np.floating) else 2, (TRIED_WORLDS, *self.inputs[name]))
            for name, kind in self.dtypes.items()
        }
        arrays = {name: values.astype(self.dtypes[name]) for name, values in arrays.items()}
        limit = onnxruntime.RunOptions()
        clock = threading.Timer(LONGEST_TRIAL, setattr, (limit, "terminate", True))
        clock.start()
        try:
            together = self.run(arrays, run_options=limit)
            for ids in ([*range(1, TRIED_WORLDS), 0], [0]):
                part = self.run({name: values[ids] for name, values in arrays.items()}, run_options=limit)
                if not all(
                    np.allclose(a[ids], b, rtol=ROUNDING, equal_nan=True) for a, b in zip(together, part, strict=True)
                ):
                    raise ValueError("a world's outputs depend on other worlds")
        except Exception as error:
            slow = f"trying it takes more than {LONGEST_TRIAL:g} s"
            raise _refused(self._path, slow if limit.terminate else f"it cannot be run: {error}") from error
        finally:
            clock.cancel()
        return [list(values.shape[1:]) for values in together]


def load_graph(path: Path) -> AgentGraph:
    """Return the graph in a file, checked once for each content of it. Raises `AgentFileError`."""
    return _checked(path, _content(path))


_checked = functools.lru_cache(maxsize=MAX_KEPT)(AgentGraph)


def _content(path: Path) -> bytes:
    try:
        return bounded_bytes(path, LARGEST_FILE)
    except OSError as error:
        raise AgentFileError(f"the agent's graph {path} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise _refused(path, str(error)) from error


def _model(path: Path, content: bytes) -> ModelProto:
    try:
        return onnx.load_model_from_string(content)
    except Exception as error:  # protobuf's, which is no dependency of ours
        raise _refused(path, str(error)) from error


def _check_operators(model: ModelProto, path: Path) -> None:
    """Check that all operators are standard ones, without subgraphs, functions and files beside."""
    graph = model.graph
    if model.functions or graph.sparse_initializer or len(graph.node) > MAX_NODES:
        raise _refused(path, f"an agent has no functions, no sparse arrays and up to {MAX_NODES} nodes")
    for node in graph.node:
        if node.domain not in ("", "ai.onnx") or node.op_type not in OPERATORS:
            name = f"{node.domain}.{node.op_type}" if node.domain else node.op_type
            raise _refused(path, f"agents do not use the operator {name!r}.{nearest(node.op_type, OPERATORS)}")
        if any(kind.type in (AttributeProto.GRAPH, AttributeProto.GRAPHS) for kind in node.attribute):
            raise _refused(path, f"its operator {node.op_type} has a graph inside")
    if any(tensor.data_location == TensorProto.EXTERNAL for tensor in _tensors(model)):
        raise _refused(path, "some of its numbers are in another file")


def _constants(model: ModelProto, path: Path) -> dict[str, NDArray[Any]]:
    """Return all constant arrays of a graph by name. Raises `AgentFileError` if one is not what it says."""
    tensors = [(tensor.name, tensor) for tensor in model.graph.initializer]
    tensors += [
        (node.output[0], attribute.t)
        for node in model.graph.node
        if node.op_type == "Constant" and node.output
        for attribute in node.attribute
        if attribute.name == "value"
    ]
    try:
        constants = {name: onnx.numpy_helper.to_array(tensor) for name, tensor in tensors}
    except Exception as error:  # NumPy's and onnx's are of several kinds
        raise _refused(path, f"one of its constant arrays is broken: {error}") from error
    if len(constants) < len(tensors):
        raise _refused(path, "two of its constant arrays have one name")
    return constants


def _tensors(model: ModelProto) -> Iterator[TensorProto]:
    yield from model.graph.initializer
    for node in model.graph.node:
        for attribute in node.attribute:
            yield attribute.t
            yield from attribute.tensors


def _check_sizes(model: ModelProto, constants: dict[str, NDArray[Any]], path: Path) -> int:
    """Return how many numbers the graph takes and computes for two worlds; check that all sizes are known and bounded.

    Raises `AgentFileError`.
    """
    two_worlds = _for_two_worlds(model)
    _check_slices(two_worlds, path)
    graph = _inferred(two_worlds, path).graph
    _check_divisors(graph, constants, path)
    values = (*graph.input, *graph.value_info, *graph.output)
    shapes = {value.name: _shape(value) for value in values}
    shapes |= {tensor.name: list(tensor.dims) for tensor in graph.initializer}
    unknown = [value.name for value in graph.input if not shapes[value.name]]
    numbers, work = sum(math.prod(shapes[value.name] or [0]) for value in graph.input), 0
    for node in graph.node:
        inputs = [shapes.get(name) for name in node.input]
        for name in filter(None, node.output):
            if shapes.get(name) is None and node.op_type in SAME_SIZE and inputs[0] is not None:
                shapes[name] = [math.prod(inputs[0])]
            shape = shapes.get(name)
            unknown += [name] if shape is None else []
            numbers += math.prod(shape or [0])
            work += _work(node, inputs, shape or [0])
    if unknown:
        raise _refused(path, f"the size of {unknown[0]!r} is not known beforehand")
    if numbers > MAX_NUMBERS or work > MAX_WORK:
        raise _refused(
            path,
            f"for two worlds, it takes and computes {numbers:,} numbers with {work:,} multiplications, more than "
            f"{MAX_NUMBERS:,} or {MAX_WORK:,}",
        )
    return numbers


def _for_two_worlds(model: ModelProto) -> ModelProto:
    """Return the model as it is for two worlds, without what the file says of sizes and the numbers of large arrays."""
    two_worlds = ModelProto()
    two_worlds.CopyFrom(model)
    initialised = {tensor.name for tensor in model.graph.initializer}
    for value in two_worlds.graph.input:
        if value.name not in initialised and (dims := value.type.tensor_type.shape.dim):
            dims[0].dim_value = 2
    for output in two_worlds.graph.output:
        output.type.tensor_type.ClearField("shape")  # it names the number of worlds
    del two_worlds.graph.value_info[:]  # what the file says of sizes in between
    for tensor in _tensors(two_worlds):
        if tensor.ByteSize() > LARGEST_SIZES:
            tensor.CopyFrom(TensorProto(name=tensor.name, data_type=tensor.data_type, dims=tensor.dims))
    return two_worlds


def _check_divisors(graph: GraphProto, constants: dict[str, NDArray[Any]], path: Path) -> None:
    """Check that whole numbers are divided by positive constants only: by 0 or -1, the processor ends the process."""
    types = {value.name: value.type.tensor_type.elem_type for value in (*graph.input, *graph.value_info, *graph.output)}
    for node in graph.node:
        if node.op_type != "Div" or types.get(node.output[0]) in FLOATS:
            continue
        divisor = constants.get(node.input[1])
        if divisor is None or not (divisor > 0).all():
            raise _refused(path, f"it divides whole numbers by {node.input[1]!r}, which may be 0 or negative")


def _work(node: NodeProto, inputs: list[list[int] | None], result: list[int]) -> int:
    """Return an upper bound on multiplications for a node's result; 0 for operators that need about one a number."""
    sizes = [math.prod(shape or [0]) for shape in inputs]
    match node.op_type:
        case "MatMul" | "Gemm":
            return math.prod(result) * max(inputs[0] or [0])
        case "Conv":
            return math.prod(result) * math.prod((inputs[1] or [0])[1:])
        case "MaxPool" | "AveragePool":
            kernels = [attribute.ints for attribute in node.attribute if attribute.name == "kernel_shape"]
            return math.prod(result) * math.prod(int(size) for kernel in kernels for size in kernel)
        case "LSTM" | "GRU" | "RNN":
            return (sizes[1] + sizes[2]) * math.prod((inputs[0] or [0])[:2])
    return 0


def _check_slices(model: ModelProto, path: Path) -> None:
    """Check that no sliced dimension is empty or negative: inferring the shape of such a slice ends the process."""
    nodes = model.graph.node
    slices = [i for i, node in enumerate(nodes) if node.op_type == "Slice"]
    if len(slices) > MAX_SLICES:
        raise _refused(path, f"it has {len(slices):,} slices, more than {MAX_SLICES}")
    if any(size < 0 for tensor in _tensors(model) for size in tensor.dims):
        raise _refused(path, "one of its arrays has a negative size")
    for i in slices:
        earlier_part = ModelProto()
        earlier_part.CopyFrom(model)
        del earlier_part.graph.node[i:], earlier_part.graph.output[:]
        graph = _inferred(earlier_part, path).graph
        dims = {tensor.name: list(tensor.dims) for tensor in graph.initializer}
        for value in (*graph.input, *graph.value_info):
            dims[value.name] = [dim.dim_value for dim in value.type.tensor_type.shape.dim]
        if nodes[i].input and any(size < 1 for size in dims.get(nodes[i].input[0], [0])):
            raise _refused(path, f"it slices {nodes[i].input[0]!r}, of which a dimension is empty or unknown")


def _inferred(model: ModelProto, path: Path) -> ModelProto:
    try:
        return onnx.shape_inference.infer_shapes(model, check_type=True, strict_mode=True, data_prop=True)
    except Exception as error:  # onnx raises several kinds
        raise _refused(path, f"its shapes do not fit together: {error}") from error


def _shape(value: ValueInfoProto) -> list[int] | None:
    kind = value.type.tensor_type
    if not kind.HasField("shape") or not all(
        dim.HasField("dim_value") and dim.dim_value >= 0 for dim in kind.shape.dim
    ):
        return None
    return [int(dim.dim_value) for dim in kind.shape.dim]


def _refused(path: Path, why: str) -> AgentFileError:
    return AgentFileError(f"{path} is not an ONNX graph that armctl runs: {why}")

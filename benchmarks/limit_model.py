"""Work of a decision, and the least time that it takes: arithmetic, memory, wake-ups, and operations that are measured.

    limit = max(flops / peak, bytes / bandwidth) + wake-ups * time of one + sum of operations * time of one

Arithmetic and memory overlap, the rest does not.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import ModelProto

from armctl.agents.graph import _for_two_worlds, _inferred, _shape

TRANSFORM_FLOPS = 63
"""Flops of a product of two rigid transforms: 45 for the rotations, 18 for the translation."""


@dataclass(frozen=True)
class Work:
    """Work that a decision cannot do without."""

    flops: float = 0.0
    bytes: float = 0.0
    """Bytes that are read and written once: inputs, weights and results."""
    wake_ups: int = 0
    operations: Mapping[str, float] = field(default_factory=dict)
    """Numbers of operations whose time is measured, by name."""
    precision: str = "float64"


@dataclass(frozen=True)
class Machine:
    """Speed of one core."""

    peaks: Mapping[str, float]
    """Flops per second, by precision."""
    bandwidths: Mapping[float, float]
    """Bytes per second, read and written, by the number of bytes up to which they are reached, the smallest first."""
    wake_up: float
    """Seconds until another process is woken up."""
    operations: Mapping[str, float]
    """Seconds of operations, by name."""

    def limit(self, work: Work) -> float:
        """Return the least time of a decision, s."""
        sizes = [size for size in self.bandwidths if work.bytes <= size] or list(self.bandwidths)[-1:]
        computing = max(work.flops / self.peaks[work.precision], work.bytes / self.bandwidths[sizes[0]])
        operations = sum(count * self.operations[name] for name, count in work.operations.items())
        return computing + work.wake_ups * self.wake_up + operations


@dataclass(frozen=True)
class Decision:
    """A decision, what measures its time (s) in about so many seconds, and its work."""

    name: str
    measure: Callable[[float], float]
    work: Work


def num_bytes(*arrays: Any) -> int:
    """Return the bytes of arrays, and of those in dictionaries."""
    return sum(num_bytes(*each.values()) if isinstance(each, dict) else np.asarray(each).nbytes for each in arrays)


def network_work(model: ModelProto, inputs: float, num_envs: int) -> Work:
    """Return the work of a network for one of `num_envs` worlds, each with so many bytes of `inputs` and results.

    Weights are read once for all worlds.
    """
    weights = sum(onnx.numpy_helper.to_array(tensor).nbytes for tensor in model.graph.initializer)
    return Work(flops=2 * multiplications(model), bytes=weights / num_envs + inputs, precision="float32")


def multiplications(model: ModelProto) -> float:
    """Return the multiplications of one world in products and convolutions; activations are not counted.

    Raises `ValueError` for recurrent layers.
    """
    graph = _inferred(_for_two_worlds(model), Path("network")).graph
    shapes = {value.name: _shape(value) for value in (*graph.input, *graph.value_info, *graph.output)}
    shapes |= {tensor.name: list(tensor.dims) for tensor in graph.initializer}
    total = 0
    for node in graph.node:
        match node.op_type:
            case "Gemm":
                result = shapes[node.output[0]]
                total += result[1] * math.prod(shapes[node.input[0]])
            case "MatMul":
                total += math.prod(shapes[node.output[0]]) * shapes[node.input[0]][-1]
            case "Conv":
                total += math.prod(shapes[node.output[0]]) * math.prod(shapes[node.input[1]][1:])
            case "GRU" | "LSTM" | "RNN":
                raise ValueError(f"multiplications of {node.op_type} are not counted")
    return total / 2


def closed_form_work(dof: int, branches: float, operation: str) -> Work:
    """Return the work of inverse kinematics: angles of each branch, and its forward kinematics to check it.

    A joint takes an arc tangent, a sine, a cosine (three of the named `operation`) and a product of transforms.
    """
    numbers = 16 + branches * (dof + 1)
    return Work(
        flops=TRANSFORM_FLOPS * dof * branches,
        bytes=numbers * np.float64().nbytes,
        operations={operation: 3 * dof * branches},
    )

"""Agents' networks as ONNX graphs, without a trace of the machine that wrote them."""

import logging
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch

from armctl.agents import INPUT, NEXT, OUTPUT


def write_graph(
    module: torch.nn.Module,
    inputs: Mapping[str, gymnasium.Space[Any]],
    memory: Mapping[str, Sequence[int]],
    path: Path,
) -> None:
    """Write a network from observations and memory to actions and the next memory as an ONNX graph.

    `inputs` are the spaces of the observation's arrays, `memory` the shapes of what is remembered, by name. The first
    axis of every input and output is the number of worlds, which is free.
    """
    samples = {name: np.asarray(space.sample())[None].repeat(2, 0) for name, space in inputs.items()}
    examples = {name: torch.as_tensor(sample) for name, sample in samples.items()} | dict(
        zip(memory, initial_memory(memory, 2), strict=True)
    )
    batch = torch.export.Dim("worlds", min=1)
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it warns that torchvision is missing
    with warnings.catch_warnings(action="ignore"):
        program = torch.onnx.export(
            module.eval(),
            tuple(examples.values()),
            input_names=list(examples),
            output_names=[OUTPUT, *(NEXT + name for name in memory)],
            dynamic_shapes=(tuple({0: batch} for _ in examples),),
            dynamo=True,
            verbose=False,
        )
    assert program is not None
    graph = program.model_proto
    for node in (*graph.graph.node, *(node for function in graph.functions for node in function.node)):
        node.ClearField("metadata_props")  # stack traces, with paths
        node.ClearField("doc_string")
    path.write_bytes(graph.SerializeToString())


def initial_memory(memory: Mapping[str, Sequence[int]], num_envs: int) -> list[torch.Tensor]:
    """Return what is remembered at the beginning of episodes: zeros (n, ...) of the shapes in `memory`."""
    return [torch.zeros(num_envs, *shape) for shape in memory.values()]


def observation_of(inputs: Mapping[str, Any], arrays: Sequence[torch.Tensor]) -> Any:
    """Return the observation of which these are the arrays, in the order of `inputs`: one array, or several by name."""
    return arrays[0] if list(inputs) == [INPUT] else dict(zip(inputs, arrays, strict=True))

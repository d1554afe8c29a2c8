"""Writes torch modules as ONNX graphs, without a trace of the machine that wrote them."""

import logging
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import torch


def write_graph(
    module: torch.nn.Module, examples: Mapping[str, torch.Tensor], outputs: Sequence[str], path: Path
) -> None:
    """Write a module as an ONNX graph with named inputs and outputs.

    `examples` are the module's arguments for two worlds, by name. The graph takes any number of worlds, the first axis
    of every input and output.
    """
    batch = torch.export.Dim("worlds", min=1)
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)  # it warns that torchvision is missing
    with warnings.catch_warnings(action="ignore"):
        program = torch.onnx.export(
            module.eval(),
            tuple(examples.values()),
            input_names=list(examples),
            output_names=list(outputs),
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

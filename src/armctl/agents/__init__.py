"""Learned agents as files: an ONNX graph and a JSON card with its costs and lineage."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.agents.agent import (
        CARD,
        FILES,
        GRAPH,
        INPUT,
        NEXT,
        OUTPUT,
        AgentCard,
        Ancestor,
        Conversion,
        Evaluation,
        OnnxPolicy,
        distinct,
        inputs,
        load_agent,
        read_agent,
        read_card,
        sha256,
        shapes,
    )  # fmt: skip

__all__ = [
    "CARD", "FILES", "GRAPH", "INPUT", "NEXT", "OUTPUT", "AgentCard", "Ancestor", "Conversion", "Evaluation",
    "OnnxPolicy", "distinct", "inputs", "load_agent", "read_agent", "read_card", "sha256", "shapes",
]  # fmt: skip

__getattr__, __dir__ = on_first_use(__name__)

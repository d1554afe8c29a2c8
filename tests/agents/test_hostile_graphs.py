"""Graphs that strangers made to break, fill or deceive the process: each is refused in words, by one check."""

import itertools
import json
import resource
import shutil
import time

import numpy as np
import pytest
from onnx import TensorProto, helper, numpy_helper

from armctl.agents import OnnxPolicy, graph, read_card, sha256
from armctl.agents.graph import load_graph
from armctl.core.errors import AgentFileError
from armctl.policies.trainings import card_path

from ..command_line import armctl
from .test_graph import dividing, identity, model_of, saved

ADD = helper.make_node("Add", ["observation", "w"], ["action"])
MEGABYTES_OF_A_REFUSAL = 100


def with_array(change, in_a_node=False):
    """Adds an array whose description is changed."""
    array = numpy_helper.from_array(np.ones(6, np.float32), "w")
    change(array)
    if in_a_node:
        return model_of([helper.make_node("Constant", [], ["w"], value=array), ADD])
    model = model_of([ADD], constants={"w": np.ones(6, np.float32)})
    model.graph.initializer[0].CopyFrom(array)
    return model


def with_numbers(count):
    return lambda array: setattr(array, "raw_data", b"\0\0\0\0" * count)


def of_type(kind):
    return lambda array: setattr(array, "data_type", kind)


def of_size(*sizes):
    def change(array):
        array.dims[:] = sizes

    return change


BROKEN = {
    "cut": lambda array: setattr(array, "raw_data", array.raw_data[:-3]), "empty": with_numbers(0),
    "too long": with_numbers(60), "text": of_type(TensorProto.STRING), "untyped": of_type(TensorProto.UNDEFINED),
    "of no type": of_type(99), "negative": of_size(-6), "huge": of_size(2**62), "overflowing": of_size(2**31, 2**31, 4),
    "of no size": of_size(0), "negative twice": of_size(-2, -3),
}  # fmt: skip


@pytest.mark.parametrize("in_a_node", [False, True])
@pytest.mark.parametrize("change", BROKEN.values(), ids=BROKEN)
def test_broken_constants(change, in_a_node, tmp_path):
    with pytest.raises(AgentFileError, match="is not an ONNX graph that armctl runs"):
        load_graph(saved(with_array(change, in_a_node), tmp_path))


def repeated(name, value, divisor=False):
    model = dividing(1) if divisor else model_of([ADD], constants={"w": np.ones(6, np.float32)})
    model.graph.initializer.append(numpy_helper.from_array(value, name))
    return model


@pytest.mark.parametrize(
    "model",
    [repeated("w", np.zeros(6, np.float32)), repeated("d", np.array(0, np.int32), divisor=True)],
)
def test_two_constants_of_one_name(model, tmp_path):
    with pytest.raises(AgentFileError, match="two of its constant arrays have one name"):
        load_graph(saved(model, tmp_path))


def with_input(kind, *sizes):
    model = model_of([identity()])
    model.graph.input.append(helper.make_tensor_value_info("more", kind, ["worlds", *sizes]))
    return model


def with_many_inputs():
    model = model_of([identity()])
    model.graph.input.extend(
        helper.make_tensor_value_info(f"more{i}", TensorProto.FLOAT, ["worlds", 10**4]) for i in range(3000)
    )
    return model


def without_worlds():
    model = model_of([identity()], result=None)
    del model.graph.input[0].type.tensor_type.shape.dim[:]
    return model


INPUTS = {
    "unbounded": with_input(TensorProto.FLOAT, 350_000_000), "overflowing": with_input(TensorProto.FLOAT, 2**40, 2**40),
    "many": with_many_inputs(), "negative": with_input(TensorProto.FLOAT, -6),
    "negative twice": with_input(TensorProto.FLOAT, -2**20, -2**20), "unknown": with_input(TensorProto.FLOAT, "any"),
    "without worlds": without_worlds(), "of one number of worlds": model_of([identity()], shape=()),
    "text": with_input(TensorProto.STRING, 6), "half": with_input(TensorProto.FLOAT16, 6),
    "complex": with_input(TensorProto.COMPLEX64, 6),
}  # fmt: skip
INPUTS["of one number of worlds"].graph.input[0].type.tensor_type.shape.dim[0].dim_value = 7


@pytest.mark.parametrize("model", INPUTS.values(), ids=INPUTS)
def test_inputs_that_cannot_be_given(model, tmp_path):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(AgentFileError, match="is not an ONNX graph that armctl runs"):
        load_graph(saved(model, tmp_path))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 1024 * MEGABYTES_OF_A_REFUSAL


def test_many_slices_beside_a_large_array(tmp_path):
    """Each slice copied all numbers."""
    names = ["observation", *(f"x{i}" for i in range(graph.MAX_SLICES - 1)), "action"]
    nodes = [helper.make_node("Slice", [a, "first", "end", "axis"], [b]) for a, b in itertools.pairwise(names)]
    constants = {name: np.array([value]) for name, value in {"first": 0, "end": 6, "axis": 1}.items()}
    path = saved(model_of(nodes, constants=constants | {"w": np.ones(10**7, np.float32)}), tmp_path)
    started = time.process_time()
    load_graph(path)
    assert time.process_time() - started < 5


def test_many_worlds_are_computed_in_parts(tmp_path, monkeypatch):
    monkeypatch.setattr(graph, "MAX_NUMBERS", 100)
    acting = load_graph(saved(model_of([helper.make_node("Sin", ["observation"], ["action"])]), tmp_path))
    session, sizes = acting._session, []

    class Session:
        def run(self, names, arrays):
            sizes.append(len(arrays["observation"]))
            return session.run(names, arrays)

    monkeypatch.setattr(acting, "_session", Session())
    observations = np.random.default_rng(0).normal(size=(50, 6)).astype(np.float32)
    np.testing.assert_allclose(acting.run({"observation": observations})[0], np.sin(observations), atol=1e-6)
    assert max(sizes) * 2 * 6 <= 4 * graph.MAX_NUMBERS
    assert sum(sizes) == 52  # filled up to a multiple of 4


def mixing(*nodes, **constants):
    return model_of(nodes, constants={"axis": np.array([0]), "first": np.array([0])} | constants)


def combined(name, *inputs, **attributes):
    """Adds what an operator makes of all worlds."""
    nodes = [helper.make_node(name, [*inputs], ["all"], **attributes)]
    return mixing(*nodes, helper.make_node("Add", ["observation", "all"], ["action"]))


MIXING = {
    **{name: combined(name, "observation", "axis") for name in ("ReduceMax", "ReduceMin", "ReduceL2", "ReduceProd")},
    "softmax": mixing(helper.make_node("Softmax", ["observation"], ["action"], axis=0)),
    "first of all": combined("Gather", "observation", "first", axis=0),
    "reversed": mixing(
        helper.make_node("Slice", ["observation", "start", "end", "axis", "step"], ["action"]),
        start=np.array([-1]), end=np.array([-(2**62)]), step=np.array([-1]),
    ),
    "transposed": mixing(
        helper.make_node("Transpose", ["observation"], ["turned"], perm=[1, 0]),
        helper.make_node("Reshape", ["turned", "size"], ["action"]), size=np.array([-1, 6]),
    ),
    "counted": mixing(
        helper.make_node("Shape", ["observation"], ["worlds"], end=1),
        helper.make_node("Cast", ["worlds"], ["count"], to=TensorProto.FLOAT),
        helper.make_node("Add", ["observation", "count"], ["action"]),
    ),
    "numbered": mixing(
        helper.make_node("Gather", ["observation", "first"], ["column"], axis=1),
        helper.make_node("ArgMax", ["column"], ["best"], axis=0),
        helper.make_node("Cast", ["best"], ["number"], to=TensorProto.FLOAT),
        helper.make_node("Add", ["observation", "number"], ["action"]),
    ),
    "sorted": mixing(
        helper.make_node("TopK", ["observation", "count"], ["action", "ids"], axis=0), count=np.array([2]),
    ),
    "of one world": mixing(helper.make_node("Identity", ["always"], ["action"]), always=np.ones((8, 6), np.float32)),
}  # fmt: skip


@pytest.mark.parametrize("model", MIXING.values(), ids=MIXING)
def test_a_graph_that_mixes_worlds(model, tmp_path):
    model.graph.output[0].type.tensor_type.ClearField("shape")
    with pytest.raises(AgentFileError, match=r"depend on other worlds|a row for each world|do not fit"):
        load_graph(saved(model, tmp_path))


@pytest.fixture
def agent(tmp_path):
    for suffix in (".json", ".onnx"):
        shutil.copy(card_path("reach_ppo").with_suffix(suffix), tmp_path / f"agent{suffix}")
    return tmp_path / "agent.json"


def edit(card, **changes):
    card.write_text(json.dumps(json.loads(card.read_text()) | changes))


MEMORY = {"past_observation": [1, 12], "begun": [1]}


@pytest.mark.parametrize(
    "changes",
    [
        *({"memory": MEMORY | {"begun": shape}} for shape in ([2], [], [-1], [1, 1], [2**40], [10**9, 10**9])),
        {"memory": {}},
        {"memory": MEMORY | {"observation": [12]}},
        {"memory": MEMORY | {"past_observation": [12]}},
        *({"action_shape": shape} for shape in ([], [7], [-6], [6, 1], [2**62])),
        *({"observation_shape": shape} for shape in ([13], [-12], [], {"observation": [12], "more": [1]})),
    ],
)
def test_cards_of_other_shapes_than_the_graph_has(agent, changes):
    edit(agent, **changes)
    with pytest.raises(AgentFileError, match="by its card, it maps"):
        OnnxPolicy(agent.with_suffix(".onnx"), read_card(agent))


@pytest.mark.parametrize("model", [with_array(BROKEN["cut"]), INPUTS["unbounded"], dividing(None), MIXING["reversed"]])
def test_compare_refuses_it(agent, model):
    saved(model, agent.parent)
    edit(agent, sha256=sha256(agent.with_suffix(".onnx")))
    done = armctl("compare", "agent.json", "--episodes", "1", cwd=agent.parent, check=False)
    assert done.returncode == 2
    assert "is not an ONNX graph that armctl runs" in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr

"""Mutated results, agents, recipes and curves: each is read, or refused in words."""

import contextlib
import copy
import csv
import io
import itertools
import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from types import NoneType

import onnx
import pytest
from onnx import AttributeProto, TensorProto, helper

from armctl.agents import sha256
from armctl.agents.graph import OPERATORS
from armctl.core.errors import ResultsError
from armctl.episodes.stored import STORE
from armctl.episodes.table import TYPES
from armctl.policies.trainings import card_path
from armctl.study import compare, suite, sweep
from armctl.study.line_up import SuiteSize

from ..forgery import change_record, rewrite
from ..stores import read_cell
from .child import Child
from .mutation import mutated_bytes, outcomes_of

HERE = Path(__file__).parent
OPTIONS = {"max_episode_steps": 2}
HOSTILE = [
    None, True, False, -1, 0, 1, 10**18, 10**400, 1e300, 5e-324, float("nan"), float("inf"), "", "nan", "x" * 5_000,
    "[/]", "\x1b[2J", "\x00", "\ud800", "../../x", "evil:make", "armctl/BridgeCross-v0", "reach_ik", "random", [], {},
    [[]], [None] * 50, {"x": {}}, {"": ""}, "armctl/ArmReach-v0", "ur10", "1e999", "{'a': " * 50, "(" * 500,
]  # fmt: skip
TOML = [
    "nan", "-inf", "1e400", "9" * 30, "[]", "[[[]]]", "{}", "{a = {b = {}}}", '""', '"[/]"', '"\\u0000"', "true",
    "1979-05-27T07:32:00Z", "00:00:00", '"evil:make"', '"' + "x" * 5_000 + '"', "[1, 'x', {}]", "0x" + "f" * 40, "-1",
    "0", "1.5",
]  # fmt: skip


def mutated_values(rng, values):
    """JSON values with one to three of them replaced, removed, or put elsewhere."""
    changed = copy.deepcopy(values)
    for _ in range(rng.randint(1, 3)):
        places = list(_places(changed))
        if not places:
            return changed
        parent, key = rng.choice(places)
        match rng.randrange(6):
            case 0:
                del parent[key]
            case 1:
                donor, other = rng.choice(places)
                parent[key] = copy.deepcopy(donor[other])
            case 2 if isinstance(parent, dict):
                parent[str(rng.choice(HOSTILE))[:99]] = rng.choice(HOSTILE)
            case _:
                parent[key] = copy.deepcopy(rng.choice(HOSTILE))
    return changed


def _places(values):
    entries = (
        list(values.items())
        if isinstance(values, dict)
        else list(enumerate(values))
        if isinstance(values, list)
        else []
    )
    for key, value in entries:
        yield values, key
        yield from _places(value)


def text_of(values):
    return json.dumps(values).encode()


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    """Folders of a comparison, a sweep, a suite, an agent, a recipe and a curve."""
    home = tmp_path_factory.mktemp("originals")
    compare(["random", "reach_ppo"], episodes=3, out=home / "results", env_options=OPTIONS)
    sweep(["random"], disturbances={"delay": [1]}, episodes=2, out=home / "swept", env_options=OPTIONS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("armctl.study.suite_plan.FULL", SuiteSize(2, ("delay",), (0.25,)))
        patch.setattr("armctl.study.suite_plan.line_up", lambda *_: ("reach_ik", "reach_ppo"))
        suite(["armctl/ArmReach-v0"], episodes=2, out=home / "suite")
    card = card_path("reach_ppo")
    for name in ("agent", "recipe", "curve"):
        (home / name).mkdir()
    for suffix in (".json", ".onnx"):
        shutil.copy(card.with_suffix(suffix), home / "agent" / f"agent{suffix}")
    shutil.copy(card.parents[1] / "recipes" / "reach_dagger.toml", home / "recipe" / "recipe.toml")
    shutil.copy(card.with_suffix(".csv"), home / "curve" / "curve.csv")
    return home


@pytest.fixture(scope="module")
def load(tmp_path_factory, originals):
    """Do something with a copy of an original, after a change to it."""
    home, child, numbers = tmp_path_factory.mktemp("mutated"), Child(HERE / "load_file.py"), itertools.count()

    def change_and_load(original, doing, change):
        copied = home / doing / str(next(numbers))
        shutil.copytree(originals / original, copied)
        change(copied)
        answer = child(copied)
        shutil.rmtree(copied)
        return answer

    yield change_and_load
    child.close()


def one_file(rng, names):
    """Mutates the bytes of one of the files."""

    def change(folder):
        path = folder / rng.choice(names)
        path.write_bytes(mutated_bytes(rng, path.read_bytes()))

    return change


def entry(rng, *slow):
    """What is done with results: mostly no more than reading them."""
    return rng.choice(slow) if rng.random() < 0.2 else "read"


def results_bytes(load, rng):
    return load("results", entry(rng, "report", "resume"), one_file(rng, [STORE]))


def results_facts(load, rng):
    def change(folder):
        stored = read_cell(folder)
        rewrite(folder, stored.identity, mutated_values(rng, stored.facts), stored.episodes, stored.runs)

    return load("results", entry(rng, "report"), change)


HOSTILE_VALUES = {
    str: ["", "x" * 5_000, "[/]", "\x1b[2J", "../../x", "random", "reach_ppo"],
    float: [0.0, -1.0, 5e-324, 1e300, math.inf, -math.inf, math.nan],
    int: [-(2**62), -1, 0, 1, 2**62],
    bool: [True, False],
    NoneType: [None],
}


def results_forged(load, rng):
    """Identity, facts and episodes of somebody's choice, which belong together by all checksums."""

    def change(folder):
        identity, facts, runs, episodes = read_cell(folder)
        results = list(episodes)
        for name in rng.sample(sorted(set(TYPES) - {"env", "seed"}), rng.randint(0, 3)):
            row = rng.randrange(len(results))
            value = rng.choice(HOSTILE_VALUES[rng.choice(sorted(TYPES[name], key=str))])
            results[row] = with_value(results[row], name, value)
        identity, facts = (mutated_values(rng, one) if rng.random() < 0.5 else one for one in (identity, facts))
        with contextlib.suppress(ResultsError):  # two of one policy's episodes with one number, which no store holds
            rewrite(folder, identity, facts, results, runs)

    return load("results", entry(rng, "report", "report", "resume"), change)


def with_value(result, name, value):
    if hasattr(result.metrics, name):
        return replace(result, metrics=replace(result.metrics, **{name: value}))
    return replace(result, **{name: value})


def table(path):
    return list(csv.reader(io.StringIO(path.read_text())))


def study_record(load, rng):
    def change(folder):
        change_record(folder, lambda record: replace_all(record, mutated_values(rng, dict(record))))

    return load(rng.choice(["swept", "suite"]), entry(rng, "report"), change)


def replace_all(values, others):
    values.clear()
    values.update(others)


def sweep_bytes(load, rng):
    return load("swept", entry(rng, "report"), one_file(rng, [STORE]))


def agent_card(load, rng):
    """A mutated card of a small evaluation."""

    def change(folder):
        path = folder / "agent.json"
        values = json.loads(path.read_text())
        values["evaluation"]["episodes"] = 2
        if rng.random() < 0.8:
            path.write_bytes(text_of(played_soon(mutated_values(rng, values))))
        else:
            path.write_bytes(mutated_bytes(rng, path.read_bytes()))

    return load("agent", rng.choice(["agent", "reproduce"]), change)


def played_soon(card):
    """The card, whose evaluation does not take hours because another count, such as of training steps, got there."""
    evaluation = card.get("evaluation")
    if isinstance(evaluation, dict) and isinstance(evaluation.get("episodes"), int):
        evaluation["episodes"] = 2 if 2 < evaluation["episodes"] < 10**9 else evaluation["episodes"]
    return card


def agent_graph(load, rng):
    """A mutated graph, and the right checksum on the card."""

    def change(folder):
        path = folder / "agent.onnx"
        content = path.read_bytes()
        path.write_bytes(mutated_bytes(rng, content) if rng.random() < 0.4 else mutated_graph(rng, content))
        card = json.loads((folder / "agent.json").read_text())
        (folder / "agent.json").write_bytes(text_of(card | {"sha256": sha256(path)}))

    return load("agent", "agent", change)


def mutated_graph(rng, content):
    """A graph with one to three of its nodes, attributes, arrays and sizes changed."""
    model = onnx.load_model_from_string(content)
    graph = model.graph
    for _ in range(rng.randint(1, 3)):
        node, tensor = rng.choice(graph.node), rng.choice(graph.initializer)
        value = rng.choice([*graph.input, *graph.output])
        match rng.randrange(9):
            case 0:
                node.op_type = rng.choice([*sorted(OPERATORS), "Loop", "If", "RandomNormal", "NonZero", "Nope", ""])
            case 1:
                names = [name for one in graph.node for name in (*one.input, *one.output)]
                node.input[:] = [rng.choice([name, *rng.sample(names, 2), "", "nope"]) for name in node.input]
            case 2:
                graph.node.remove(node) if len(graph.node) > 1 else None
            case 3:
                graph.node.append(node)
            case 4:
                number = rng.choice(
                    [-(2**63), -1, 0, 1, 2**31, 2**63 - 1, [1, 2], [], [-1, 2**62], 0.5, float("nan"), "x", ""]
                )
                name = rng.choice(
                    ["axis", "axes", "alpha", "to", "keepdims", "perm", "transA", "shape", "value", "nope"]
                )
                kind = None if number != [] else AttributeProto.INTS
                node.attribute.append(helper.make_attribute(name, number, attr_type=kind))
            case 5:
                tensor.dims[:] = rng.choice([[], [0], [-1], [2**40], [1, *tensor.dims], list(reversed(tensor.dims))])
            case 6:
                tensor.data_type = rng.choice(TensorProto.DataType.values())
            case 7:
                for dim in value.type.tensor_type.shape.dim:
                    dim.dim_value = rng.choice([-1, 0, 1, 6, 2**31, 2**62])
            case _:
                model.opset_import[0].version = rng.choice([-1, 0, 1, 7, 12, 13, 18, 21, 99])
    return model.SerializeToString()


def recipe(load, rng):
    def change(folder):
        path = folder / "recipe.toml"
        if rng.random() < 0.4:
            path.write_bytes(mutated_bytes(rng, path.read_bytes()))
            return
        lines = path.read_text().splitlines()
        for _ in range(rng.randint(1, 3)):
            i = rng.randrange(len(lines))
            name = lines[i].partition("=")[0]
            lines[i] = rng.choice(
                [f"{name} = {rng.choice(TOML)}", f"{name} = {rng.choice(TOML)}", f"[{name}]", "", rng.choice(lines)]
            )
        path.write_text("\n".join(lines))

    return load("recipe", "recipe", change)


def curve(load, rng):
    def change(folder):
        path = folder / "curve.csv"
        if rng.random() < 0.5:
            path.write_bytes(mutated_bytes(rng, path.read_bytes()))
            return
        lines = table(path)
        for _ in range(rng.randint(1, 3)):
            line = rng.choice(lines)
            line[rng.randrange(len(line))] = str(rng.choice(HOSTILE))
        path.write_text("\n".join(map(",".join, lines)), errors="replace")

    return load("curve", "curve", change)


KINDS = {
    results_bytes: 300, results_facts: 400, results_forged: 900, study_record: 1000, sweep_bytes: 400,
    agent_card: 1000, agent_graph: 1000, recipe: 1000, curve: 1000,
}  # fmt: skip
"""How often each is tried: 1,000 times or more for results, sweeps, suites, cards, graphs, recipes and curves."""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("original", "doing"),
    [
        ("results", "report"),
        ("results", "resume"),
        ("swept", "report"),
        ("suite", "report"),
        ("agent", "agent"),
        ("recipe", "recipe"),
        ("curve", "curve"),
    ],
)
def test_what_is_not_mutated_is_read(load, original, doing):
    assert load(original, doing, lambda folder: None) == ("fine", "")


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_mutated_file_is_read_or_refused(load, kind):
    assert "refused" in outcomes_of(load, kind, 15)


@pytest.mark.thorough
@pytest.mark.parametrize(("kind", "count"), KINDS.items())
def test_a_thousand_mutated_files_are_read_or_refused(load, kind, count):
    assert "refused" in outcomes_of(load, kind, count)

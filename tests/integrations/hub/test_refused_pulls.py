"""What is not whole, not there or not ours on a hub: it is refused, and nothing is written."""

import hashlib
import json
import re
import tempfile
import time
from pathlib import Path

import onnx
import pytest
from huggingface_hub import constants

from armctl.core.errors import AgentFileError, ConfigurationError, HubError
from armctl.integrations.hub import client, pull, push
from armctl.integrations.hub.download import LARGEST
from armctl.policies.trainings import card_path

from .fake_hub import NAME, broken_off, contents, endless, huge, published, trickling


def foreign_graph():
    value = onnx.helper.make_tensor_value_info("observation", onnx.TensorProto.FLOAT, [None, 12])
    other = onnx.helper.make_tensor_value_info("action", onnx.TensorProto.FLOAT, [None, 12])
    node = onnx.helper.make_node("Loader", ["observation"], ["action"], domain="com.evil")
    graph = onnx.helper.make_graph([node], "foreign", [value], [other])
    return onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)]).SerializeToString()


def spoilt(agent):
    """What is said, and the changes of an agent's files of which it is said."""
    graph, card = (agent / "agent.onnx").read_bytes(), json.loads((agent / "agent.json").read_text())
    foreign = foreign_graph()
    its_card = json.dumps(card | {"sha256": hashlib.sha256(foreign).hexdigest()}).encode()
    other_memory = json.dumps(card | {"memory": {"lstm": [8]}}).encode()
    longer_memory = json.dumps(card | {"memory": card["memory"] | {"begun": [2**40]}}).encode()
    return [
        ("changed, or damaged", {"agent.onnx": graph[:-1] + b"x"}),
        ("changed, or damaged", {"agent.json": card_path("reach_bc").read_bytes()}),
        ("do not use the operator 'com.evil.Loader'", {"agent.onnx": foreign, "agent.json": its_card}),
        ("by its card, it maps", {"agent.json": other_memory}),
        ("by its card, it maps", {"agent.json": longer_memory}),
        ("not an agent's card", {"agent.json": b"\x80\x04cos\nsystem"}),
        ("has no agent.json", {"agent.json": None}),
        ("has no agent.onnx", {"agent.onnx": None}),
        ("curve.csv", {"curve.csv": b"<html>"}),
        ("agent.onnx of owner/reach has 1,000,000,000,000 bytes", {"agent.onnx": huge}),
        ("agent.json of owner/reach has", {"agent.json": endless}),
        ("broke off", {"agent.onnx": broken_off(graph)}),
        ("broke off", {"agent.json": broken_off(its_card)}),
    ]


@pytest.mark.parametrize("case", range(13))
def test_what_is_not_whole_is_refused_and_not_written(hub, agent, monkeypatch, case, request):
    says, changes = spoilt(agent)[case]
    published(hub, agent, **changes)
    monkeypatch.setitem(LARGEST, "agent.json", 10**6)
    request.getfixturevalue("nothing_written")
    with pytest.raises((AgentFileError, HubError), match=re.escape(says)) as raised:
        pull(NAME)
    assert tempfile.gettempdir() not in str(raised.value)


@pytest.mark.parametrize(
    "name",
    ["", "reach", "../reach", "owner/..", "owner/../../x", "/etc/passwd", "owner/a b", "owner//x", "own\ner/x", "~/x",
     "https://huggingface.co/owner/reach", "owner\\reach", "owner/x.git", "owner/reach@", "@main"],
)  # fmt: skip
def test_a_name_that_no_repository_has(hub, agent, name, nothing_written):
    with pytest.raises(ConfigurationError, match=r"repository|revision"):
        pull(name)
    if "@" not in name:
        with pytest.raises(ConfigurationError, match="repository"):
            push(agent, name)
    assert hub.asked == []


@pytest.mark.parametrize("revision", ["v9", "../../main", "a b", "x" * 300, "main/../../secret", "\x1b[2J"])
def test_a_revision_that_there_is_not(hub, agent, revision):
    published(hub, agent)
    with pytest.raises(HubError, match="no such revision"):
        pull(f"{NAME}@{revision}")
    assert not Path("agents").exists()


def test_a_repository_that_there_is_not(hub, nothing_written):
    with pytest.raises(HubError, match="has no owner/none"):
        pull("owner/none")


@pytest.mark.parametrize("status", [400, 403, 404, 418, 500, 503])
@pytest.mark.parametrize("where", ["GET /api", "resolve"])
def test_a_hub_that_fails(hub, agent, where, status, request):
    published(hub, agent)
    hub.failing[where] = status
    request.getfixturevalue("nothing_written")
    with pytest.raises(HubError, match=f"status {status}: so it was decided"):
        pull(NAME)


@pytest.mark.one_case
@pytest.mark.parametrize("where", ["create", "validate", "preupload", "commit", "batch", "stored"])
def test_a_hub_that_fails_while_it_is_given_something(hub, agent, where):
    hub.lfs = True
    hub.failing[where] = 418
    with pytest.raises(HubError):
        push(agent, NAME)
    hub.failing.clear()
    push(agent, NAME)
    assert contents(pull(NAME).parent) == contents(agent)


@pytest.mark.parametrize("address", ["http://127.0.0.1:9", "nowhere", "http://[::bad", "ftp://127.0.0.1"])
def test_a_hub_that_is_not_there(hub, agent, monkeypatch, address):
    monkeypatch.setattr(constants, "ENDPOINT", address)
    with pytest.raises(HubError, match="cannot be reached"):
        pull(NAME)
    with pytest.raises(HubError, match="cannot be reached"):
        push(agent, NAME)


@pytest.mark.parametrize("where", ["agent.json", "agent.onnx", "curve.csv", "info", "create"])
def test_a_hub_that_trickles(hub, agent, monkeypatch, where, request):
    monkeypatch.setattr(client, "LONGEST_TRANSFER", 1.0)
    published(hub, agent, **({where: trickling} if where in LARGEST else {}))
    if where not in LARGEST:
        monkeypatch.setattr(hub.RequestHandlerClass, "do_POST" if where == "create" else "do_GET", trickling)
    else:
        request.getfixturevalue("nothing_written")
    started = time.monotonic()
    with pytest.raises(HubError, match="has not finished within 1 s"):
        push(agent, NAME) if where == "create" else pull(NAME)
    assert time.monotonic() - started < 10


@pytest.mark.parametrize("answer", [b"<html>", b"[]", b"{}", b'{"id": "owner/reach"}', b"null"])
def test_what_is_no_hub(hub, agent, monkeypatch, answer):
    monkeypatch.setattr(hub.RequestHandlerClass, "do_GET", lambda self: self.send(answer))
    with pytest.raises(HubError, match=hub.address):
        pull(NAME)

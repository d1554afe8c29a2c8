"""Edits that change what an object does change its checksum, and nothing else does, in whatever process."""

import functools
import importlib.util
import os
import subprocess
import sys
import textwrap
import threading
from pathlib import PurePath
from typing import Any

import numba
import numpy as np
import pytest
import torch

from armctl.core.registration import installed
from armctl.policies.names import GROUP
from armctl.runtime.fingerprint import UNKNOWN, fingerprint
from armctl.runtime.own_code import in_plugin

BASE = """
import enum, functools
import numpy as np
import helpers

GAIN = 1.0
TABLE = {"a": [1, 2], 3: {"x", "y", "z"}, (1, "b"): None, None: 0}

def unused():
    return 1

def inner(x):
    return GAIN * x

class Base:
    scale = 2.0

    def act(self, observation):
        return self.scale * inner(observation)

class Policy(Base):
    def __init__(self):
        self.first, self.second = 1.0, TABLE

    @functools.cached_property
    def offset(self):
        return helpers.OFFSET + Kind.ONE.value

    @property
    def both(self):
        return self.first + self.offset

    def __getstate__(self):
        return {}

class Slotted:
    __slots__ = ("only",)

    def __init__(self):
        self.only = 6.0

class Kind(enum.Enum):
    ONE = 1

@functools.cache
def cached(x):
    return x + 1

def default(x, y=3.0):
    return cached(x) + y

def outer():
    z = [4.0]
    return lambda x: default(x) + z[0]

def made():
    return [Policy(), Slotted(), outer(), Policy, functools.partial(default, y=5.0)]
"""
HELPERS = "OFFSET = 0.5\nUNUSED = 1\n"
EDITS = {
    "a global": ("GAIN = 1.0", "GAIN = 1.5"),
    "a global inside a global": ('{"a": [1, 2]', '{"a": [1, 3]'),
    "a set inside a global": ('"z"}', '"w"}'),
    "code of a function that is called": ("return GAIN * x", "return GAIN + x"),
    "an attribute of a base class": ("scale = 2.0", "scale = 3.0"),
    "code of a base class": ("return self.scale *", "return self.scale +"),
    "an attribute that pickle leaves out": ("self.first, self.second = 1.0", "self.first, self.second = 1.5"),
    "a slot": ("self.only = 6.0", "self.only = 6.5"),
    "an enumeration": ("ONE = 1", "ONE = 2"),
    "a property": ("self.first + self.offset", "self.first - self.offset"),
    "a cached property": ("helpers.OFFSET +", "helpers.OFFSET -"),
    "a cached function": ("return x + 1", "return x + 2"),
    "a default": ("y=3.0", "y=3.5"),
    "a closure": ("z = [4.0]", "z = [4.5]"),
    "an argument of a partial": ("y=5.0", "y=5.5"),
}


def load(folder, name, text):
    """A module of a folder that no library's is, which is loaded as a script loads a plug-in."""
    path = folder / f"{name}.py"
    path.write_text(text)
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def checksum(folder, monkeypatch, text=BASE, helpers=HELPERS):
    folder.mkdir(exist_ok=True)
    monkeypatch.setitem(sys.modules, "helpers", load(folder, "helpers", helpers))
    monkeypatch.setitem(sys.modules, "mine", module := load(folder, "mine", text))
    return fingerprint(module.made())


def test_every_edit_of_what_is_used_counts_and_no_other(tmp_path, monkeypatch):
    original = checksum(tmp_path / "0", monkeypatch)
    assert not original.startswith(UNKNOWN), original
    assert checksum(tmp_path / "0", monkeypatch) == original
    assert checksum(tmp_path / "0", monkeypatch, "# lower\n" + BASE.replace("return 1\n", "return 2\n")) == original
    for what, (old, new) in EDITS.items():
        assert BASE.count(old) == 1
        assert checksum(tmp_path / "0", monkeypatch, BASE.replace(old, new)) != original, what
    assert checksum(tmp_path / "0", monkeypatch, helpers=HELPERS.replace("0.5", "0.6")) != original


@pytest.mark.parametrize("name", ["GAIN", "OFFSET"])
def test_a_global_that_a_script_sets_counts(tmp_path, monkeypatch, name):
    original = checksum(tmp_path, monkeypatch)
    place = sys.modules["mine" if name == "GAIN" else "helpers"]
    monkeypatch.setattr(place, name, 7.0)
    assert fingerprint(sys.modules["mine"].made()) != original


class Net(torch.nn.Module):
    def __init__(self, gain=1.0, activation=torch.nn.Tanh, seed=0):
        super().__init__()
        torch.manual_seed(seed)
        self.layers = torch.nn.Sequential(torch.nn.Linear(3, 2), activation())
        self.gain = gain
        self.register_buffer("mean", torch.zeros(3, dtype=torch.bfloat16))

    def forward(self, x):
        return self.gain * self.layers(x)


class Deeper(Net):
    def forward(self, x):
        return super().forward(super().forward(x))


def trained(net):
    return [net, net.eval()][1]


def test_a_torch_module_counts_by_type_code_and_attributes_and_not_by_its_parameters_only():
    original = fingerprint(Net())
    assert not original.startswith(UNKNOWN), original
    assert fingerprint(Net()) == original
    frozen = Net()
    frozen.layers[0].weight.requires_grad_(False)
    hooked = Net()
    hooked.register_forward_hook(lambda *given: None)
    others = Net(gain=2.0), Net(activation=torch.nn.ReLU), Net(seed=1), Deeper(), trained(Net()), frozen, hooked
    checksums = {original, *map(fingerprint, others)}
    assert len(checksums) == 1 + len(others)


def make_compiled(gain):
    @numba.njit
    def compiled(x):
        return gain * x

    return lambda observation: compiled(observation)


class Named(dict):
    pass


class Row(np.ndarray):
    pass


@pytest.mark.parametrize(
    "make",
    [
        make_compiled,
        lambda gain: Named(gain=gain),
        lambda gain: np.full(3, gain).view(Row),
        lambda gain: np.array([gain, "a", None], dtype=object),
        lambda gain: np.random.default_rng(int(10 * gain)),
        lambda gain: np.float32(gain),
        lambda gain: {("a", gain): 1, "b": 2},
        lambda gain: {frozenset({gain, "a"}), "b"},
        lambda gain: [memoryview, len, [gain].index],
        lambda gain: functools.partialmethod(lambda self, x: x, gain),
    ],
)
def test_other_kinds_of_objects(make):
    assert fingerprint(make(0.1)) == fingerprint(make(0.1))
    assert fingerprint(make(0.1)) != fingerprint(make(0.9))
    assert not fingerprint(make(0.1)).startswith(UNKNOWN)


def test_what_has_no_checksum_is_named_by_its_place():
    class Mine:
        def __init__(self):
            self.parts = {"log": [threading.Lock()]}

    given = Mine()
    assert fingerprint(given).startswith("unknown (its .parts.log[0] of type lock: TypeError: cannot pickle")
    assert fingerprint(given) != fingerprint(given)


def test_objects_that_lead_to_themselves():
    def ring(value):
        second: dict[str, Any] = {"b": 1}
        first = [value, second]
        second["a"] = first
        return first

    assert fingerprint(ring(1)) == fingerprint(ring(1)) != fingerprint(ring(2))


@pytest.mark.slow
def test_installed_policies_have_the_same_checksum_in_every_process():
    """Whatever the order of sets is there, and whether modules are compiled or loaded from their cache."""
    script = textwrap.dedent("""
        from armctl.runtime.fingerprint import fingerprint
        from armctl.core.registration import installed
        print(fingerprint({name: installed("armctl.policies")[name].load() for name in NAMES}))
    """)
    names = ["random", "reach_ik", "reach_mpc", "bridge_mpc", "reach_ppo"]
    here = fingerprint({name: installed(GROUP)[name].load() for name in names})
    assert not here.startswith(UNKNOWN)
    command = [sys.executable, "-B", "-c", script.replace("NAMES", repr(names))]
    there = subprocess.run(
        command, capture_output=True, text=True, env=os.environ | {"PYTHONHASHSEED": "5"}, check=True
    )
    assert there.stdout.strip() == here


def test_a_plugin_counts_by_content_wherever_it_is_installed(monkeypatch):
    from armctl import baselines
    from armctl.baselines import random_actions

    original = fingerprint(random_actions.RandomActions)
    monkeypatch.setattr(random_actions.RandomActions, "training_steps", 1)
    assert fingerprint(random_actions.RandomActions) != original
    assert in_plugin(PurePath(baselines.__file__)).is_absolute() is False

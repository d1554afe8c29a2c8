"""Each integration is importable alone: it loads no other, and its heavy library only when it is used."""

import json
import subprocess
import sys

import pytest

import armctl.integrations

HEAVY = ("huggingface_hub", "mlflow", "wandb", "tensorboard", "torch", "stable_baselines3", "rerun")
NEEDS = {"sb3": {"torch", "stable_baselines3"}}
"""Libraries that the module subclasses, so that its import needs them."""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hub", "lerobot", "lerobot.dataset", "rerun", "sb3", "tracking"])
def test_importing_one_loads_no_other_and_no_library_of_others(name):
    program = f"import json, sys, armctl.integrations.{name}; print(json.dumps(list(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    modules = json.loads(done.stdout)
    prefix = armctl.integrations.__name__ + "."
    loaded = {module.removeprefix(prefix).split(".")[0] for module in modules if module.startswith(prefix)}
    assert loaded == {name.split(".")[0]}
    assert set(HEAVY) & set(modules) <= NEEDS.get(name, set()) | ({"tensorboard"} if name == "sb3" else set())

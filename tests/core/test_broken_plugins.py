"""Packages that offer something and cannot be imported, or offer what armctl has: only who names them hears of it."""

import importlib.metadata
import sys
from importlib.metadata import EntryPoint, EntryPoints

import pytest

from armctl.cli import completion
from armctl.core import registration
from armctl.core.errors import ConfigurationError
from armctl.core.registration import installed
from armctl.datasets.formats import load_format, load_formats
from armctl.integrations.tracking.tracker import load_tracker
from armctl.policies import describe_policy
from armctl.training.learners import load_exporter, load_learner, load_recipe, recipe_names

from ..command_line import armctl

GROUPS = ("policies", "learners", "recipes", "exporters", "trackers", "dataset_formats")
BROKEN = {
    "raises": ("raise RuntimeError('[red]boom')", "broken:x"),
    "exits": ("import sys; sys.exit(5)", "broken:x"),
    "no Python": ("def f(:", "broken:x"),
    "imports what there is not": ("import not_there_either", "broken:x"),
    "is not there": ("", "not_there:x"),
    "has not this": ("", "broken:x"),
    "is in a broken package": ("raise RuntimeError('boom')", "broken.deeper.still:x"),
    "has no such name": ("", "broken:"),
}


@pytest.fixture(params=BROKEN)
def plugin(request, tmp_path, monkeypatch):
    """Installs a package that offers `odd` in all groups, and `reach_ik`, `ppo` and so on in place of armctl's own."""
    text, value = BROKEN[request.param]
    (tmp_path / "broken.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    offered = {
        f"armctl.{group}": [EntryPoint(name, value, f"armctl.{group}") for name in ("odd", "reach_ik", "ppo", "zip")]
        for group in GROUPS
    }
    real = importlib.metadata.entry_points
    monkeypatch.setattr(
        registration, "entry_points", lambda group: EntryPoints([*offered.get(group, ()), *real(group=group)])
    )
    installed.cache_clear()
    yield tmp_path
    installed.cache_clear()
    sys.modules.pop("broken", None)


@pytest.mark.one_case
def test_who_names_it_is_told_in_a_line(plugin):
    for load in (describe_policy, load_learner, load_tracker, load_format):
        with pytest.raises(ConfigurationError, match=r"cannot load the .* odd: "):
            load("odd")
    with pytest.raises(ConfigurationError, match="cannot load the exporter odd: "):
        load_exporter(plugin / "model.odd")
    done = armctl("compare", "odd", "--episodes", "1", cwd=plugin, check=False)
    assert done.returncode == 2
    assert "cannot load the policy odd: " in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_everybody_else_goes_on(plugin):
    assert describe_policy("reach_ik")
    assert load_learner("ppo")
    assert load_exporter(plugin / "model.zip")
    assert load_recipe("ppo").learner == "ppo"
    assert "reach_ppo" in recipe_names()
    assert {"minari", "lerobot"} <= set(load_formats())
    assert "reach_ppo" in completion.recipes("reach")
    assert "reach_ppo" in completion.agents("reach")
    listed = armctl("list", cwd=plugin).stdout
    assert "odd" in listed
    armctl("compare", "reach_ik", "--episodes", "1", "--set", "max_episode_steps=2", cwd=plugin)

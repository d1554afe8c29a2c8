import shutil

import pytest

from armctl.tuning import tune

from ..sealing import sealed  # noqa: F401 - a fixture
from .small_tunings import RECIPE, expert


@pytest.fixture
def recipe(tmp_path):
    file = tmp_path / "small.toml"
    file.write_text(RECIPE)
    return str(file)


@pytest.fixture(scope="module")
def one_trial(tmp_path_factory):
    folder = tmp_path_factory.mktemp("one_trial")
    tune(expert(), folder, trials=1)
    return folder


@pytest.fixture
def begun(one_trial, tmp_path):
    """The folder of a tuning with one trial."""
    return shutil.copytree(one_trial, tmp_path / "begun")

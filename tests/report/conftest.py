import shutil

import pytest

from armctl.study import compare

from .pages import OPTIONS, POLICIES


@pytest.fixture(scope="package")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    compare(POLICIES, episodes=12, worlds=4, out=folder, env_options=OPTIONS)
    return folder


@pytest.fixture
def folder(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "results")

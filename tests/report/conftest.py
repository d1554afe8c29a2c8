import shutil

import pytest

from armctl.study import compare, sweep

from .pages import OPTIONS, POLICIES


@pytest.fixture(scope="package")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    compare(POLICIES, episodes=12, worlds=4, out=folder, env_options=OPTIONS)
    return folder


@pytest.fixture(scope="package")
def finished_sweep(tmp_path_factory):
    folder = tmp_path_factory.mktemp("swept")
    levels: dict[str, list[float]] = {"noise": [0.05, 0.1], "delay": [1, 3]}
    sweep(POLICIES, disturbances=levels, episodes=12, worlds=4, out=folder, env_options=OPTIONS)
    return folder


@pytest.fixture
def swept(finished_sweep, tmp_path):
    return shutil.copytree(finished_sweep, tmp_path / "swept")


@pytest.fixture
def folder(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "results")

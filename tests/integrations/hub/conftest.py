import shutil

import pytest
from huggingface_hub import constants

from armctl.policies.trainings import card_path

from .fake_hub import TOKEN, serving


@pytest.fixture
def hub(monkeypatch, tmp_path):
    """A hub that is asked instead of Hugging Face's, by its owner."""
    with serving() as hub:
        template = constants.HUGGINGFACE_CO_URL_TEMPLATE.replace(constants.ENDPOINT, hub.address)
        monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)
        monkeypatch.setattr(constants, "ENDPOINT", hub.address)
        monkeypatch.setattr(constants, "HF_TOKEN_PATH", str(tmp_path / "no-token"))
        monkeypatch.setattr(constants, "HF_HUB_DISABLE_XET", True)
        monkeypatch.setenv("HF_ENDPOINT", hub.address)  # of programs that a test starts
        monkeypatch.setenv("HF_TOKEN", TOKEN)
        monkeypatch.chdir(tmp_path)
        yield hub


@pytest.fixture
def agent(tmp_path):
    """A training's folder, with an agent that may be spoilt."""
    folder, shipped = tmp_path / "trained", card_path("reach_ppo")
    folder.mkdir()
    for name, suffix in (("agent.onnx", ".onnx"), ("agent.json", ".json"), ("curve.csv", ".csv")):
        shutil.copy(shipped.with_suffix(suffix), folder / name)
    return folder


@pytest.fixture
def nothing_written(tmp_path):
    before = set(tmp_path.rglob("*"))
    yield
    assert set(tmp_path.rglob("*")) == before

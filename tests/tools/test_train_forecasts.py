import numpy as np
import pytest
import torch
import train_forecasts

from armctl.baselines.hybrids import target_forecast
from armctl.baselines.hybrids.target_forecast import KNOTS, POSITION, READ, VELOCITY, WINDOW, TargetForecast


def test_examples_go_on_from_what_was_read():
    torch.manual_seed(0)
    windows, targets = (part.numpy() for part in train_forecasts.examples(500))
    has_read = windows[:, READ] > 0
    np.testing.assert_allclose((windows[:, POSITION] * has_read).sum(axis=1), 0.0, atol=1e-4)
    assert (windows[:, :READ].swapaxes(1, 2)[~has_read] == 0).all()
    assert has_read[:, -1].all()
    errors = windows[:, :READ, -1] - targets[:, :, 0]
    assert np.median(np.abs(errors[:, POSITION])) < 0.01
    assert np.median(np.abs(errors[:, VELOCITY])) < 0.01
    assert np.abs(errors).max() < 0.5


@pytest.mark.slow
def test_a_trained_network_is_read_back(tmp_path, monkeypatch):
    train_forecasts.train(0, 100, tmp_path)
    monkeypatch.setattr(target_forecast, "FOLDER", tmp_path)
    forecast = TargetForecast(0)
    assert forecast.cost.gradient_steps == 100
    assert forecast(np.zeros((3, 3, WINDOW))).shape == (3, 2, len(KNOTS))

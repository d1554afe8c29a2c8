from typing import Any

import numpy as np
import pytest
import torch

from armctl.envs import make_worlds
from armctl.rl.networks.onnx_graph import initial_memory
from armctl.rl.networks.recurrent import RecurrentNetwork
from armctl.rl.networks.view import view_of

MOVING = "armctl/BridgeCrossMoving-v0"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "tolerance"), [({}, 0.1), ({"missing_barriers": 5}, 0.1), ({"resolution": (24, 16)}, 0.3)]
)
def test_ranges_in_an_image_are_those_of_a_drawing_even_when_the_rover_nods(options, tolerance):
    n = 16
    true = make_worlds(MOVING, n, options, autoreset_mode="disabled")
    drawn = make_worlds(
        MOVING, n, {**options, "observation": "ranges", "dynamics": "kinematic"}, autoreset_mode="disabled"
    )
    prepare = view_of(true).preparation(true.single_observation_space)
    true.reset(seed=5), drawn.reset(seed=5)
    rng, errors, nods = np.random.default_rng(1), [], []
    for step in range(16):
        if step % 4 == 0:
            commands = rng.uniform([-0.5, -1.0], [2.0, 1.0], (n, 2))
        image = true.step(commands)[0]
        drawn.step(commands)
        drawn.task.rover._poses[:] = true.task.state.poses  # the same view
        nods.append(true.task.rover.upright)
        seen = prepare({name: torch.as_tensor(part) for name, part in image.items()})["ranges"].numpy()
        running = ~(true._finished | drawn._finished)
        errors.append(np.abs(np.minimum(seen, 6.0) - np.minimum(drawn.task.rover.scan(None), 6.0))[running])
    assert np.min(nods) < np.cos(0.1)
    assert np.quantile(np.concatenate(errors), 0.9) < tolerance


def test_noise_of_each_pixel_hardly_changes_robust_ranges():
    worlds: Any = make_worlds("armctl/BridgeCross-v0", 4, {})
    image = torch.as_tensor(worlds.reset(seed=3)[0]["image"])
    noisy = (image + 0.1 * torch.randn(image.shape, generator=torch.Generator().manual_seed(0))).clamp(0, 10)
    changes = {}
    for features in ("plain", "robust"):
        prepare = view_of(worlds, features=features).preparation(worlds.single_observation_space)
        clear, seen = (prepare({"image": depths, "motion": None})["ranges"] for depths in (image, noisy))
        changes[features] = (clear - seen).abs().median().item()
    assert changes["plain"] > 0.5
    assert changes["robust"] < 0.1  # an average over four pixels, of 0.1 m each
    assert (prepare({"image": torch.zeros_like(image), "motion": None})["ranges"] == 0).all()


def test_a_network_sees_the_last_image_while_images_are_lost():
    worlds: Any = make_worlds("armctl/BridgeCross-v0", 3, {})
    observed = {name: torch.as_tensor(part) for name, part in worlds.reset(seed=3)[0].items()}
    extractor = view_of(worlds, features="robust").extractor(worlds.single_observation_space)
    torch.manual_seed(0)
    network = RecurrentNetwork(extractor, hidden_units=32, layers=1, memory_units=32, actions=2)
    _, *memory = network(observed, *initial_memory(network.memory, 3))
    expected, *_ = network(observed, *memory)
    actions, *_ = network(observed | {"image": torch.zeros_like(observed["image"])}, *memory)
    assert torch.equal(actions, expected)
    other, *_ = network(observed | {"image": 2 * observed["image"]}, *memory)
    assert not torch.equal(other, expected)


def test_robust_ranges_of_an_image_without_noise_are_those_of_a_drawing():
    options = {"observation": "ranges", "dynamics": "kinematic"}
    true: Any = make_worlds("armctl/BridgeCross-v0", 16, {})
    drawn: Any = make_worlds("armctl/BridgeCross-v0", 16, options)
    image = {name: torch.as_tensor(part) for name, part in true.reset(seed=5)[0].items()}
    seen = view_of(true, features="robust").preparation(true.single_observation_space)(image)["ranges"].numpy()
    expected = drawn.reset(seed=5)[0]["ranges"]
    assert np.quantile(np.abs(np.minimum(seen, 6.0) - np.minimum(expected, 6.0)), 0.85) < 0.15


def test_ranges_stay_as_they_are():
    drawn = make_worlds(MOVING, 2, {"observation": "ranges", "dynamics": "kinematic"})
    observed = {name: torch.as_tensor(part) for name, part in drawn.reset(seed=0)[0].items()}
    assert view_of(drawn).preparation(drawn.single_observation_space)(observed) is observed

import numpy as np
import pytest
import torch

from armctl.envs import make_worlds
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


def test_ranges_stay_as_they_are():
    drawn = make_worlds(MOVING, 2, {"observation": "ranges", "dynamics": "kinematic"})
    observed = {name: torch.as_tensor(part) for name, part in drawn.reset(seed=0)[0].items()}
    assert view_of(drawn).preparation(drawn.single_observation_space)(observed) is observed

"""Arms and boxes around them."""

import numpy as np

from armctl.robot_description import arm as arms
from armctl.scene import Boxes


def named_arm(name, **options):
    """A named arm, as it is or, if it is the Panda, by the path of its URDF file."""
    if name != "panda":
        return name
    return arms.load_arm(arms.robot_data() / "panda_description/urdf/panda.urdf", tip="panda_hand_tcp", **options)


def random_boxes(rng, model, count=6):
    """Boxes that are not too near to an arm at home."""
    while True:
        boxes = Boxes(
            rng.uniform((-0.8, -0.8, 0), (0.8, 0.8, 1), (count, 3)),
            rng.uniform(0.02, 0.12, (count, 3)),
            rng.uniform(-np.pi, np.pi, count),
        )
        if not count or model.box_distances(model.home, boxes).min() > 0.03:
            return boxes

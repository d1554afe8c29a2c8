import numpy as np
import pytest

from armctl.kinematics import THOROUGH, ArmModel, MinimumTimeReach, ReachTimes, Workspace
from armctl.robot_description import load_arm


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["ur5", "panda"])
def test_times_are_near_above_the_least(robot):
    model = ArmModel(load_arm(robot))
    times, touch, workspace = ReachTimes(model, 0.05), MinimumTimeReach(model, THOROUGH), Workspace(model)
    rng = np.random.default_rng(0)
    centres = np.array([workspace.sample(rng, clearance=0.05) for _ in range(30)])
    q = np.clip(model.home + rng.uniform(-0.7, 0.7, (30, model.dof)), model.limits.lower, model.limits.upper)
    velocity = rng.uniform(-0.7, 0.7, (30, model.dof)) * model.limits.velocity
    found = times.min_times(q, velocity, times.spheres(centres))
    least = np.array([touch.min_time(*one) for one in zip(q, centres, np.full(30, 0.05), velocity, strict=True)])
    assert (found > least - 0.05).mean() >= 0.9, "even the thorough search misses some, where joints are moving"
    assert np.median(found - least) < 0.05


def test_goals_are_in_the_sphere_or_said_not_to_be():
    model = ArmModel(load_arm("ur5"))
    times = ReachTimes(model, 0.05)
    centres = np.array([[0.4, 0.2, 0.5], [3.0, 0.0, 0.5]])
    spheres = times.spheres(centres)
    off = np.linalg.norm(model.positions(spheres.goals) - centres[:, None], axis=-1)
    np.testing.assert_allclose(spheres.excess, np.maximum(off - 0.05, 0.0), atol=1e-12)
    assert (spheres.excess[0] == 0).mean() > 0.9
    assert (spheres.excess[1] > 1.5).all()
    assert model.within_limits(spheres.goals).all()
    least = times.min_times(np.tile(model.home, (2, 1)), np.zeros((2, 6)), spheres)
    assert np.isfinite(least).all()
    assert least[1] > 1.5


@pytest.mark.slow
def test_a_batch_is_as_its_members():
    model = ArmModel(load_arm("z1"))
    times = ReachTimes(model, 0.03)
    rng = np.random.default_rng(2)
    centres, q, velocity = rng.uniform(-0.4, 0.4, (7, 3)), rng.uniform(0, 1, (7, 6)), rng.uniform(-1, 1, (7, 6))
    spheres = times.spheres(centres)
    alone = [times.min_times(q[i : i + 1], velocity[i : i + 1], times.spheres(centres[i : i + 1]))[0] for i in range(7)]
    np.testing.assert_allclose(times.min_times(q, velocity, spheres), alone, rtol=1e-9)

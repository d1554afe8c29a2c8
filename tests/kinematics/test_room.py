import numpy as np

from armctl.kinematics import ArmModel, Ik
from armctl.kinematics.room import DIRECTIONS, moved_along, room, with_room

MODEL = ArmModel("ur5")


def test_places_around_are_as_far_away_in_different_directions():
    np.testing.assert_allclose(np.linalg.norm(DIRECTIONS, axis=1), 1)
    assert len(np.unique(DIRECTIONS.round(6), axis=0)) == 14


def test_a_stretched_arm_has_no_room_outwards_and_a_bent_one_has():
    q = MODEL.random_configurations(np.random.default_rng(0), 5000)
    farthest = q[np.argmax(np.linalg.norm(MODEL.positions(q) - MODEL.shoulder, axis=1))]
    stretched, bent = room(MODEL, np.array([farthest, MODEL.home]), 0.1)
    assert stretched < 0.7
    assert bent > 0.9


def test_the_posture_with_room_is_free_on_target_and_has_more_of_it_than_most():
    ik, rng = Ik(MODEL), np.random.default_rng(0)
    for target in rng.uniform(0.2, 0.5, (3, 3)):
        chosen = with_room(ik, target, MODEL.home, 0.15)
        np.testing.assert_allclose(MODEL.position(chosen), target, atol=1e-5)
        assert MODEL.is_free(chosen)
        others = np.array(list(ik.free_configurations(target)))
        assert room(MODEL, chosen[None], 0.15) >= np.quantile(room(MODEL, others, 0.15), 0.5)


def test_out_of_reach_there_is_none():
    assert with_room(Ik(MODEL), np.array([3.0, 0, 0]), MODEL.home, 0.15) is None


def test_a_posture_moves_along_with_a_target_as_fast_as_joints_can():
    near, far = (MODEL.position(MODEL.home) + distance * np.array([0.0, 0.6, 0.8]) for distance in (0.02, 0.5))
    np.testing.assert_allclose(MODEL.position(moved_along(MODEL, MODEL.home, near, 0.04)), near, atol=1e-3)
    moved = moved_along(MODEL, MODEL.home, far, 0.04)
    assert np.abs(moved - MODEL.home).max() <= 0.04 * MODEL.limits.velocity.max() + 1e-12
    closer = np.linalg.norm(MODEL.position(moved) - far)
    assert 0.3 < closer < 0.45

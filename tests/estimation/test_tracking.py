"""Tracks of people, on synthetic crossings."""

import numpy as np

from armctl.estimation.tracking import PeopleTracker, TrackerOptions

OBSERVER = np.zeros(2)
NOBODY = np.zeros((0, 2))
BEARINGS = np.linspace(-0.9, 0.9, 61)


def sight(people, radius=0.25):
    """Points (61, 2) of discs that are seen from the origin, NaN where there is none, and the ends (61, 2) of rays."""
    people = np.reshape(people, (-1, 2))
    directions = np.column_stack((np.cos(BEARINGS), np.sin(BEARINGS)))
    along = directions @ people.T
    miss = np.sum(people**2, axis=1) - along**2
    ranges = np.where((miss < radius**2) & (along > 0), along - np.sqrt(np.maximum(radius**2 - miss, 0)), np.inf)
    ranges = ranges.min(axis=1, initial=np.inf)[:, None]
    return directions * np.where(ranges < 10, ranges, np.nan), directions * np.minimum(ranges, 10.0)


def track(tracker, people, tall=True):
    points, ends = sight(people)
    none = np.full_like(points, np.nan)
    tracker.predict()
    tracker.update(OBSERVER, points if tall else none, none if tall else points, ends)


def test_two_who_cross_are_followed_through_misses_and_false_points():
    rng, tracker = np.random.default_rng(0), PeopleTracker()
    for step in range(40):
        time = 0.1 * step
        people = np.array(((3.0, -1.5 + 0.8 * time), (4.2, 1.5 - 0.8 * time)))
        if rng.random() < 0.2:
            tracker.predict()
            continue
        points, ends = sight(people)
        points += 0.03 * rng.standard_normal(points.shape)
        if rng.random() < 0.2:
            points[rng.integers(61)] = rng.uniform((1, -2), (6, 2))
        tracker.predict()
        tracker.update(OBSERVER, points, np.full_like(points, np.nan), ends)
    tracks = tracker.tracks
    for person, speed in zip(people, (0.8, -0.8), strict=True):
        nearest = np.linalg.norm(tracks.positions - person, axis=1).argmin()
        np.testing.assert_allclose(tracks.positions[nearest], person, atol=0.15)
        np.testing.assert_allclose(tracks.velocities[nearest], (0, speed), atol=0.35)
    assert len(tracks.positions) <= 3


def test_the_centre_stays_right_while_only_a_part_is_still_in_sight():
    tracker, edge = PeopleTracker(), np.array((2.0 * np.cos(0.9), 2.0 * np.sin(0.9)))
    for offset in np.linspace(1.0, 0.0, 16):
        track(tracker, edge - (0, offset))
    np.testing.assert_allclose(tracker.tracks.positions, [edge], atol=0.08)


def test_a_person_whose_head_is_out_of_sight_is_followed_but_not_discovered():
    tracker = PeopleTracker()
    for _ in range(5):
        track(tracker, (2.0, 0.0), tall=False)
    assert not len(tracker.tracks.positions)
    for step in range(10):
        track(tracker, (2.0, 0.06 * step), tall=step < 4)
    np.testing.assert_allclose(tracker.tracks.positions, [(2.0, 0.54)], atol=0.05)


def test_people_turn_back_at_the_side():
    tracker = PeopleTracker(TrackerOptions(turn=1.0))
    for step in range(10):
        track(tracker, (4.0, 0.1 * step - 0.05))
    for _ in range(3):
        tracker.predict()
    assert -1.5 < tracker.tracks.velocities[0, 1] < -0.7
    assert tracker.tracks.positions[0, 1] < 0.95


def test_who_would_be_seen_and_is_not_is_soon_forgotten_and_who_is_out_of_sight_is_not():
    seen, unseen = PeopleTracker(), PeopleTracker()
    for _ in range(5):
        track(seen, (3.0, 0.0))
        track(unseen, (3.0, 0.0))
    for _ in range(15):
        track(seen, NOBODY)
        unseen.predict()
    assert not len(seen.tracks.positions)
    assert len(unseen.tracks.positions) == 1


def test_points_that_are_not_numbers_and_crowds_are_survived():
    tracker = PeopleTracker(TrackerOptions(capacity=2))
    points = np.array(((2.0, -1.5), (np.nan, 0.0), (2.0, 0.0), (np.nan, np.nan), (2.0, 1.5)))
    for _ in range(3):
        tracker.predict()
        tracker.update(OBSERVER, points, np.full((2, 2), np.nan), NOBODY)
    assert len(tracker.tracks.positions) == 2
    assert np.isfinite(tracker.tracks.positions).all()

import struct
from contextlib import closing

import make_dynabarn
import numpy as np
import pytest

import armctl
from armctl.core.errors import ConfigurationError
from armctl.core.shipped import write_shipped
from armctl.envs import make_worlds
from armctl.robots.rover import RADIUS as ROVER
from armctl.tasks.bridge.dynabarn import (
    COUNTS,
    FASTEST,
    FIELDS,
    FILE,
    FORMAT,
    LEVELS,
    MAX_DISCS,
    RADIUS,
    ROUTES,
    SIDE,
    sample_routes,
    shipped_fields,
)

ENV = "armctl/BarnCrossMoving-v0"
STATE = {"observation": "state"}
SPEEDS = {"easy": (0.45, 0.96), "medium": (0.95, 1.46), "hard": (1.35, 1.96)}
"""m/s: 0.5 to 0.9, 1.0 to 1.4, 1.5 to 1.9, with the rounding of places and times to 0.01 m and s."""


def routes_of(level):
    first = LEVELS.index(level) * ROUTES
    corners, times = shipped_fields().corners
    return corners[first : first + ROUTES], times[first : first + ROUTES]


@pytest.mark.parametrize("level", LEVELS)
def test_discs_have_the_speeds_of_their_level_and_go_from_side_to_side(level):
    corners, times = routes_of(level)
    durations, lengths = np.diff(times, axis=1), np.linalg.norm(np.diff(corners, axis=1), axis=-1)
    speeds = lengths[durations > 0] / durations[durations > 0]
    assert (speeds > SPEEDS[level][0]).all()
    assert (speeds < SPEEDS[level][1]).all()
    assert np.abs(corners).max() == SIDE / 2
    assert (np.abs(corners[:, [0, -1]]).max(axis=-1) == SIDE / 2).mean() > 0.99


@pytest.mark.parametrize("level", LEVELS)
def test_fields_have_the_number_of_discs_of_their_level_on_routes_of_it(level):
    first = LEVELS.index(level)
    fields = shipped_fields().fields[first * FIELDS : (first + 1) * FIELDS]
    counts = (fields >= 0).sum(axis=1)
    assert (counts.min(), counts.max()) == COUNTS[level]
    assert set(fields[fields >= 0] // ROUTES) == {first}


@pytest.mark.parametrize("challenge", [False, True])
@pytest.mark.parametrize("level", [*LEVELS, "all"])
def test_sampled_discs_stay_in_the_square_and_the_start_is_free(level, challenge):
    for seed in range(5):
        discs = sample_routes(np.random.default_rng(seed), level, 1.0, challenge=challenge)
        moving, times = discs.speed > 0, np.linspace(0.0, 60.0, 301)
        assert discs.speed.shape == (MAX_DISCS,)
        assert COUNTS["easy" if level == "all" else level][0] <= moving.sum() <= MAX_DISCS
        x, y = discs.positions(times)[:, moving].T
        assert x.min() >= 2.0 - 1e-9
        assert max(x.max() - 22.0, np.abs(y).max() - SIDE / 2) < 1e-6
        assert np.hypot(x - 1.0, y).min() > ROVER + RADIUS
        assert np.linalg.norm(discs.velocities(times), axis=-1).max() < FASTEST


def test_worlds_show_the_discs_where_they_are_and_hide_absent_ones():
    with closing(make_worlds(ENV, 3, {**STATE, "level": "easy"})) as env:
        env.reset(seed=1)
        for _ in range(5):
            numbers, *_ = env.step(np.zeros((3, 2)))
        for world in range(3):
            discs = env.task.map(world).pedestrians
            bodies = [env.task.simulation.model.body(f"walker_{i}").id for i in range(MAX_DISCS)]
            places = env.task.simulation.per_world("body_pos")[world, bodies]
            np.testing.assert_allclose(places[:, :2], discs.positions(0.5), atol=1e-9)
            np.testing.assert_allclose(numbers[world, 6:].reshape(-1, 4)[:, :2], discs.positions(0.5), atol=1e-5)
            assert ((places[:, 2] < 0) == (discs.speed == 0)).all()


@pytest.mark.parametrize("dynamics", ["physics", "kinematic"])
def test_an_episode_ends_when_a_disc_touches_the_rover_that_drives_on(dynamics):
    with closing(make_worlds(ENV, 6, {**STATE, "dynamics": dynamics, "level": "hard"})) as env:
        env.reset(seed=2)
        nearest, collided = np.full(6, np.inf), np.zeros(6, dtype=bool)
        for step in range(120):
            *_, terminated, _, infos = env.step(np.tile((1.8, 0.0), (6, 1)))
            poses = env.task.state.poses
            for world in np.flatnonzero(~collided):
                gap = env.task.map(world).pedestrians.positions(0.1 * (step + 1)) - poses[world, :2]
                nearest[world] = min(nearest[world], np.linalg.norm(gap, axis=1).min() - RADIUS)
            collided |= terminated & ~infos["is_success"].astype(bool)
        assert collided.any()
        assert (nearest[collided] < ROVER + 0.1).all()
        assert (nearest[~collided] > 0.2).all()


@pytest.mark.slow
def test_an_expert_crosses_fields_of_the_challenge():
    options = {"fields": "challenge"}
    comparison = armctl.compare(["bridge_mpc", "random"], ENV, episodes=10, seed=306, worlds=10, env_options=options)
    assert comparison.episodes.groupby("policy").success.sum()["bridge_mpc"] >= 9


@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"level": "harder"}, "hard"),
        ({"fields": "/nowhere"}, "challenge"),
        ({"pedestrians": "reactive"}, "scripted"),
        ({"walkers": 3}, "walkers"),
        ({"deck_width": 6.0}, "deck_width"),
    ],
)
def test_a_field_that_cannot_be_is_refused(options, match):
    with pytest.raises(ConfigurationError, match=match):
        make_worlds(ENV, 1, options)


def plugin(frames, name=b"_ZN6gazebo5obs_04LoadEN5boost10shared_ptr"):
    """A plugin as the challenge has them: an ELF file with a symbol table, and code that loads numbers."""
    numbers = [frames[-1][0], *(number for t, x, y in frames for number in (t, 0.0, y, x, 0.0, 0.0, 0.0))]
    begin, constants = 64, sorted(set(numbers) - {0.0})
    first = begin + sum(4 if number == 0.0 else 8 for number in numbers)
    code = b""
    for i, number in enumerate(numbers):
        load = b"\x48\x8b\x05" if i == 0 else b"\xf2\x0f\x10\x05"
        offset = first + 8 * constants.index(number) - (begin + len(code) + len(load) + 4) if number else 0
        code += load + struct.pack("<i", offset) if number else b"\x66\x0f\xef\xc0"
    body = code.ljust(first - begin, b"\x90") + struct.pack(f"<{len(constants)}d", *constants)
    symbols = begin + len(body)
    names = symbols + make_dynabarn.SYMBOL.size
    table = names + len(name) + 1
    sections = [
        make_dynabarn.SECTION.pack(0, 2, 0, 0, symbols, make_dynabarn.SYMBOL.size, 1, 0, 0, 0),
        make_dynabarn.SECTION.pack(0, 3, 0, 0, names, len(name) + 1, 0, 0, 0, 0),
    ]
    head = bytearray(64)
    struct.pack_into("<Q", head, 0x28, table)
    struct.pack_into("<H", head, 0x3C, 2)
    symbol = make_dynabarn.SYMBOL.pack(0, 2, 0, 1, begin, len(code))
    return bytes(head) + body + symbol + name + b"\0" + b"".join(sections)


FRAMES = [(0.0, 10.0, -6.0), (6.29, 7.78, -3.78), (16.24, 4.0, 0.0), (39.73, -6.0, 10.0)]


def test_key_frames_are_read_out_of_machine_code():
    np.testing.assert_array_equal(make_dynabarn.frames_of(plugin(FRAMES)), FRAMES)


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (plugin(FRAMES, b"_ZN6gazebo5obs_0C1Ev"), "no function Load"),
        (plugin([*FRAMES[::-1], FRAMES[-1]]), "not the key frames"),
    ],
)
def test_other_machine_code_is_refused(content, match):
    with pytest.raises(ValueError, match=match):
        make_dynabarn.frames_of(content)


def test_the_file_is_the_same_for_the_same_fields(tmp_path):
    write_shipped(shipped_fields(), FORMAT, tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == FILE.read_bytes()

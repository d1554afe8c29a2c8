from contextlib import closing
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra.numpy import arrays

import armctl
from armctl.core.errors import ConfigurationError
from armctl.envs import make_worlds
from armctl.scene import BridgeMap
from armctl.tasks.bridge.fields import (
    CELL,
    CELLS,
    FIELD_X,
    HALF_WIDTH,
    ORIGIN,
    PASSAGE,
    blocks_of,
    read_blocks,
    sample_cells,
)

ENV = "armctl/BarnCross-v0"


def write_world(path, cells):
    """Write cells (`CELLS`, `CELLS`), walls included, as the challenge's files have them."""
    rows, columns = np.nonzero(cells)
    models = [
        f"<model name='unit_cylinder_{i}'><static>1</static><pose frame=''>{x:.6f} {y:.6f} 0 0 0 0</pose></model>"
        for i, (x, y) in enumerate(ORIGIN + CELL * np.column_stack((columns, rows)))
    ]
    path.write_text(f"<sdf version='1.6'><world name='default'>{''.join(models)}</world></sdf>")


def cells_below(blocks):
    """Return which cells' centres are in blocks (k, 5), and how many blocks each is in."""
    x, y = FIELD_X + CELL * (np.arange(CELLS) + 0.5), HALF_WIDTH - CELL * (np.arange(CELLS - 2) + 0.5)
    along = np.abs(x[:, None] - blocks[:, 0]) < blocks[:, 3]
    across = np.abs(y[:, None] - blocks[:, 1]) < blocks[:, 4]
    return (along[:, None] & across).sum(axis=-1)


@given(arrays(bool, (CELLS, CELLS - 2)))
def test_blocks_cover_each_filled_cell_once_and_no_other(cells):
    np.testing.assert_array_equal(cells_below(blocks_of(cells)), cells)


@pytest.mark.parametrize("seed", range(5))
def test_a_field_of_the_challenge_is_where_its_file_has_it(tmp_path, seed):
    cells = np.pad(sample_cells(np.random.default_rng(seed)), ((0, 0), (1, 1)), constant_values=True)
    write_world(tmp_path / "world_0.world", cells)
    np.testing.assert_array_equal(read_blocks(tmp_path / "world_0.world"), blocks_of(cells[:, 1:-1]))


def test_a_cell_far_ahead_on_the_right_is_far_ahead_on_the_right(tmp_path):
    cells = np.zeros((CELLS, CELLS), dtype=bool)
    cells[-1, -2] = True
    write_world(tmp_path / "world_3.world", cells)
    ((x, y, *_),) = read_blocks(tmp_path / "world_3.world")
    assert (x, y) == pytest.approx((FIELD_X + 4.425, -HALF_WIDTH + 0.075))


def test_every_field_can_be_passed_and_is_the_same_for_the_same_seed():
    maps = []
    for _ in range(2):
        with closing(make_worlds(ENV, 4, {"observation": "state"})) as env:
            env.reset(seed=3)
            maps.append([env.task.map(i) for i in range(4)])
            assert all(bridge.crossable(PASSAGE) for bridge in maps[-1])
    first, second = ([bridge.blocks for bridge in part] for part in maps)
    np.testing.assert_array_equal(first, second)
    assert not np.array_equal(first[0], first[1])


@pytest.mark.parametrize("options", [{"dynamics": "kinematic", "observation": "ranges"}, {"camera": "depth"}])
def test_what_is_seen_straight_ahead_is_the_first_block_of_the_map(options):
    observations: Any
    with closing(make_worlds(ENV, 6, {"resolution": (49, 32), **options})) as env:
        observations, _ = env.reset(seed=1)
        if "ranges" in observations:
            seen = observations["ranges"][:, 24]
        else:
            rows = np.tan(np.radians(110) / 2) / 24.5 * (15.5 - np.arange(32))
            horizon = np.abs(np.arctan(rows) - np.radians(10)).argmin()
            seen = observations["image"][:, horizon, 24] / np.cos(np.radians(10))
        for world, distance in enumerate(seen):
            bridge, camera = env.task.map(world), 1.0 + 0.215
            reach = np.arange(camera, bridge.length, 0.005)
            free = bridge.clearance(np.column_stack((reach, 0 * reach))) > 0
            expected = reach[~free].min(initial=np.inf) - camera
            assert distance == pytest.approx(expected, abs=0.15) or min(distance, expected) > 9.0


def test_driving_into_a_block_ends_the_episode():
    with closing(make_worlds(ENV, 8, {"observation": "state"})) as env:
        env.reset(seed=0)
        blocked = np.array([not _free_ahead(env.task.map(i)) for i in range(8)])
        ended = np.zeros(8, dtype=bool)
        for _ in range(80):
            *_, terminated, _, infos = env.step(np.tile((1.5, 0.0), (8, 1)))
            collided = terminated & ~infos["is_success"].astype(bool)
            ended |= collided
        assert blocked.any()
        assert ended[blocked].all()


def _free_ahead(bridge):
    return bridge.segment_clearance([(1.0, 0.0)], [(11.0, 0.0)])[0] > 0.2


@pytest.mark.parametrize("policy", ["bridge_ompl", "bridge_mpc"])
@pytest.mark.slow
def test_experts_of_the_bridge_cross_fields_with_gaps_narrower_than_the_bridges(policy):
    comparison = armctl.compare([policy, "random"], ENV, episodes=10, seed=306, worlds=10)
    assert comparison.episodes.groupby("policy").success.sum()[policy] >= 9


def test_a_narrow_gap_is_one_that_the_usual_clearance_closes(tmp_path):
    cells = np.zeros((CELLS, CELLS), dtype=bool)
    cells[10] = True
    cells[10, 12:17] = False
    write_world(tmp_path / "world_0.world", cells)
    bridge = BridgeMap(12.0, HALF_WIDTH, read_blocks(tmp_path / "world_0.world"))
    assert bridge.crossable(PASSAGE)
    assert not bridge.crossable(0.4)
    comparison = armctl.compare(
        ["bridge_ompl"], ENV, episodes=1, env_options={"fields": str(tmp_path), "observation": "state"}
    )
    assert comparison.episodes.success.all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "match"),
    [
        ({"fields": "/nowhere"}, "worlds/BARN"),
        ({"deck_width": 6.0}, "deck_width"),
        ({"missing_barriers": 1}, "missing_barriers"),
        ({"blocks": 1}, "at most 1 blocks"),
    ],
)
def test_a_field_that_cannot_be_is_refused(options, match):
    with pytest.raises(ConfigurationError, match=match):
        make_worlds(ENV, 1, options)


@pytest.mark.parametrize("text", ["", "<sdf></sdf>", "<model name='unit_cylinder_0'><pose>x y</pose></model>"])
def test_a_file_that_is_no_field_is_refused(tmp_path, text):
    (tmp_path / "world_0.world").write_text(text)
    with pytest.raises(ConfigurationError, match=r"world_0\.world"):
        make_worlds(ENV, 1, {"fields": str(tmp_path)})

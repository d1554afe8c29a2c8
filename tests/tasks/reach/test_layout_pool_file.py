"""The file of the pool of layouts: how it is made and read, and that one that is damaged or forged is refused."""

import dataclasses
import tomllib
from pathlib import Path

import make_layout_pool
import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.core.shipped import LARGEST
from armctl.envs import TaskVectorEnv
from armctl.scene import BOX_NUMBERS
from armctl.tasks import ReachObstaclesTask
from armctl.tasks.reach.layout_pool import FORMAT, PARTS, POOL_FILE, read_pool, write_pool
from armctl.tasks.reach.obstacle_layout import MAX_OBSTACLES

SHIPPED = read_pool(POOL_FILE)


def damaged(**changes):
    """The first layout of one seed's part and of all other parts as a pool of its own, with changes."""
    rows = np.array([SHIPPED.parts[name][0] for name in (SHIPPED.names[0], *PARTS)])
    small = {
        "seeds": SHIPPED.seeds[:1],
        "sizes": np.ones(len(rows), dtype=np.int64),
        "targets": SHIPPED.targets[rows],
        "counts": SHIPPED.counts[rows],
        "packed": np.concatenate([SHIPPED.boxes[row, : SHIPPED.counts[row]] for row in rows]),
        "feasible": np.ones(len(rows), dtype=bool),
    }
    return dataclasses.replace(SHIPPED, **small | changes)


def test_a_wheel_has_the_pool():
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())
    patterns = project["tool"]["setuptools"]["package-data"]["armctl.tasks.reach"]
    assert any(POOL_FILE.match(pattern) for pattern in patterns)


def test_a_pool_is_read_as_it_was_written(tmp_path):
    write_pool(SHIPPED, tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == POOL_FILE.read_bytes()


@pytest.mark.slow
def test_the_maker_makes_the_pool(tmp_path, monkeypatch, sized):
    count = sized(1, 2)
    monkeypatch.setattr(make_layout_pool, "SIZES", dict.fromkeys(PARTS, count))
    monkeypatch.setattr(make_layout_pool, "LAYOUTS_PER_SEED", count)
    make_layout_pool.main(1, tmp_path / "small.npz")
    made = read_pool(tmp_path / "small.npz")
    for part, rows in SHIPPED.parts.items():
        for name in ("targets", "boxes", "feasible"):
            np.testing.assert_array_equal(getattr(made, name)[made.parts[part]], getattr(SHIPPED, name)[rows[:count]])


def refused(path, match="install armctl again"):
    with pytest.raises(ConfigurationError, match=match):
        read_pool(path)


def test_a_damaged_file_is_refused(tmp_path, sized):
    content, path, rng = POOL_FILE.read_bytes(), tmp_path / "pool.npz", np.random.default_rng(0)
    refused(path)
    refused(tmp_path)
    for cut in (0, 1, 100, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:cut])
        refused(path)
    path.write_bytes(bytes(LARGEST + 1))
    refused(path, "more than")
    for place in rng.integers(200, len(content) - 2000, sized(10, 200)):
        path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        refused(path)


@pytest.mark.parametrize(
    "changes",
    [
        {"targets": np.zeros((4, 3))}, {"targets": np.full((4, 3), np.nan, np.float32)}, {"feasible": np.ones(4)},
        {"feasible": np.array([True, True, True, False])}, {"sizes": np.array([1, 1, 3, -1])},
        {"sizes": np.array([1, 1, 1, 2])}, {"sizes": np.ones(5, np.int64)}, {"counts": np.zeros(4, np.uint8)},
        {"counts": np.array([MAX_OBSTACLES + 1] * 4, np.uint8)}, {"counts": np.array([-1] * 4)},
        {"packed": np.zeros((0, BOX_NUMBERS), np.float32)},
    ],
    ids=str,
)  # fmt: skip
def test_arrays_that_do_not_fit_together_are_refused(changes):
    with pytest.raises(ConfigurationError):
        damaged(**changes)


def test_a_box_without_size_is_refused():
    packed = damaged().packed.copy()
    packed[0, 4] = 0.0
    with pytest.raises(ConfigurationError, match="half sizes"):
        damaged(packed=packed)


@pytest.mark.parametrize(
    "forged",
    [
        {"format": 1}, {"robot": None}, {"targets": np.array([None] * 4)}, {"unknown": 1}, {"tolerance": "much"},
        {"targets": np.zeros(LARGEST // 4, np.float32)},
    ],
    ids=["format", "missing", "pickle", "unknown", "no number", "bomb"],
)  # fmt: skip
def test_a_forged_file_is_refused(tmp_path, forged):
    pool = damaged()
    values = {"format": FORMAT} | {field.name: getattr(pool, field.name) for field in dataclasses.fields(pool)} | forged
    path = tmp_path / "pool.npz"
    np.savez_compressed(path, **{name: value for name, value in values.items() if value is not None})
    refused(path)


def test_an_environment_says_what_is_wrong_with_its_pool(tmp_path, monkeypatch):
    from armctl.tasks.reach import layout_pool

    monkeypatch.setattr(layout_pool, "POOL_FILE", tmp_path / "none.npz")
    layout_pool._shipped_pool.cache_clear()
    try:
        with pytest.raises(ConfigurationError, match="install armctl again"):
            TaskVectorEnv(1, task=ReachObstaclesTask).reset(seed=0)
        assert TaskVectorEnv(1, task=ReachObstaclesTask).task.boxes(0).distances(np.zeros(3)).size == 0
    finally:
        layout_pool._shipped_pool.cache_clear()

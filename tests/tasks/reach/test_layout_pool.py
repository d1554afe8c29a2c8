"""The pool of layouts that comes with armctl, and who draws what from it."""

import dataclasses
import functools
import itertools
import time

import gymnasium
import make_layout_pool
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from armctl.core.seeds import DEVELOPMENT_SEED, TEST_SEED, TRAINING_SEEDS, VALIDATION_SEED
from armctl.disturbances import episode_entropy
from armctl.envs import TaskVectorEnv
from armctl.kinematics import ArmModel, Workspace
from armctl.planning import PathCertificate
from armctl.robot_description import load_arm
from armctl.scene import BOX_NUMBERS, Boxes
from armctl.tasks import ReachObstaclesOptions, ReachObstaclesTask
from armctl.tasks.reach import layout_pool, read_boxes
from armctl.tasks.reach.layout_pool import (
    PARTS,
    POOL_FILE,
    SEEDS_WITH_LAYOUTS,
    part_of,
    pool_for,
    read_pool,
    robot_digest,
    write_pool,
)
from armctl.tasks.reach.obstacle_layout import MAX_OBSTACLES, sample_certified_layout

SHIPPED = read_pool(POOL_FILE)
SEEDS = st.one_of(
    st.integers(0, VALIDATION_SEED), st.integers(VALIDATION_SEED, TRAINING_SEEDS), st.integers(TRAINING_SEEDS, 2**62)
).filter(lambda seed: seed not in SEEDS_WITH_LAYOUTS)


@functools.cache
def tools() -> tuple[Workspace, PathCertificate]:
    model = ArmModel("ur5")
    return Workspace(model), PathCertificate(model)


def drawn(seed, episode, solvable=True):
    """A layout drawn without the pool: target, boxes as numbers, and whether it is certified."""
    rng = np.random.default_rng(episode_entropy(seed, episode))
    layout, feasible = sample_certified_layout(rng, *tools(), 0.05, solvable)
    boxes = np.zeros((MAX_OBSTACLES, BOX_NUMBERS))
    parts = (layout.boxes.centres, layout.boxes.half_sizes, layout.boxes.yaws)
    boxes[: len(layout.boxes)] = np.column_stack(parts)
    return layout.target, boxes, feasible


def played(worlds, seed, episode):
    """Targets, boxes and certificates of episodes."""
    worlds.reset(seed=seed, options={"episode": episode})
    task = worlds.unwrapped.task
    return task._targets.copy(), task._boxes.copy(), task._feasible.copy()


def sample(size, rows=None):
    rows = np.arange(len(SHIPPED.feasible)) if rows is None else rows
    return np.random.default_rng(0).choice(rows, min(size, len(rows)), replace=False)


def test_the_parts_are_as_large_as_made_and_share_no_layout():
    sizes = {part: len(rows) for part, rows in SHIPPED.parts.items()}
    own = dict.fromkeys(map(str, SEEDS_WITH_LAYOUTS), make_layout_pool.LAYOUTS_PER_SEED)
    assert sizes == own | make_layout_pool.SIZES, "run python tools/make_layout_pool.py --keep"
    assert len(np.unique(SHIPPED.targets, axis=0)) == len(SHIPPED.targets)
    assert all(SHIPPED.feasible[SHIPPED.parts[part]].all() for part in own)
    assert 0.99 < SHIPPED.feasible.mean() < 1
    assert POOL_FILE.stat().st_size < 2.5e6


def test_certificates_hold(sized):
    """Of some layouts of each part, and of all that have none."""
    (workspace, certificate), model = tools(), ArmModel("ur5")
    some = np.concatenate([sample(sized(4, 25), rows) for rows in SHIPPED.parts.values()])
    failed = sample(sized(2, 25), np.flatnonzero(~SHIPPED.feasible))
    home = model.home.astype(np.float32).astype(float)
    for row in np.concatenate((some, failed)):
        boxes, target = read_boxes(SHIPPED.boxes[row]), SHIPPED.targets[row].astype(float)
        path = certificate.path(home, target, boxes)
        assert (len(path) > 0) == SHIPPED.feasible[row]
        among = model.among(boxes)
        for start, end in itertools.pairwise(path):
            assert all(among.is_free(q) for q in np.linspace(start, end, 40))
        assert among.is_free(home)
        assert boxes.distances(target).min(initial=1.0) >= 0.05
        if len(path):
            np.testing.assert_allclose(workspace.model.position(path[-1]), target, atol=1e-5)


@pytest.mark.parametrize("seed", sorted(set(SEEDS_WITH_LAYOUTS)))
def test_seeds_with_layouts_of_their_own_have_those_that_are_drawn_without_a_pool(seed, sized):
    """So that the episodes of a sealed test, which is a development seed later, stay the same."""
    episodes = [0, 999, *sample(sized(3, 100), np.arange(1000)).tolist()]
    worlds = TaskVectorEnv(len(episodes), task=ReachObstaclesTask)
    for found, wanted in zip(
        played(worlds, [seed] * len(episodes), episodes),
        zip(*(drawn(seed, episode) for episode in episodes), strict=True),
        strict=True,
    ):
        np.testing.assert_array_equal(found, np.array(wanted))


@pytest.mark.parametrize(("episode", "solvable"), [(1000, True), (2**40, True), (3, False)])
def test_other_episodes_of_the_tests_seed_are_drawn_at_reset(episode, solvable):
    world = TaskVectorEnv(1, task=ReachObstaclesTask, solvable=solvable)
    for found, wanted in zip(played(world, TEST_SEED, episode), drawn(TEST_SEED, episode, solvable), strict=True):
        np.testing.assert_array_equal(found[0], wanted)


@pytest.mark.parametrize(
    ("seed", "part"),
    [
        (0, "development"), (TEST_SEED - 1, "development"), (TEST_SEED, str(TEST_SEED)),
        (TEST_SEED + 1, "development"), (DEVELOPMENT_SEED, str(DEVELOPMENT_SEED)),
        (VALIDATION_SEED - 1, "development"), (VALIDATION_SEED, "validation"), (TRAINING_SEEDS - 1, "validation"),
        (TRAINING_SEEDS, "training"), (2**62, "training"),
    ],
)  # fmt: skip
def test_each_seed_draws_from_its_part(seed, part):
    assert part_of(seed) == part
    for solvable in (True, False) if part in PARTS else (True,):
        rows = {SHIPPED.row(seed, episode, solvable) for episode in range(100)}
        assert rows <= set(SHIPPED.parts[part])


@pytest.mark.slow
@given(SEEDS, st.booleans(), st.integers(0, 2**40))
@settings(max_examples=30)
def test_a_seed_goes_through_its_part_before_a_layout_comes_again(seed, solvable, begin):
    part = SHIPPED.parts[part_of(seed)]
    wanted = part[SHIPPED.feasible[part]] if solvable else part
    rows = [SHIPPED.row(seed, begin + episode, solvable) for episode in range(len(wanted))]
    assert sorted(rows) == wanted.tolist()
    assert SHIPPED.row(seed, begin + len(rows), solvable) == rows[0]


@pytest.mark.parametrize("first", [0, TRAINING_SEEDS, 2**33])
@pytest.mark.parametrize("episode", [0, 1, 5])
def test_neighbouring_seeds_draw_as_by_chance(first, episode):
    """The worlds of a batch have consecutive seeds and start with the same episode."""
    seeds, part = range(first, first + 2000), SHIPPED.parts[part_of(first)]
    rows = np.array([SHIPPED.row(seed, episode, True) for seed in seeds if seed not in SEEDS_WITH_LAYOUTS], dtype=float)
    for lag in (1, 2, 16):
        assert abs(np.corrcoef(rows[lag:], rows[:-lag])[0, 1]) < 4 / np.sqrt(len(rows))
    by_chance = len(part) * (1 - (1 - 1 / len(part)) ** len(rows))
    assert abs(len(np.unique(rows)) - by_chance) < 4 * np.sqrt(len(rows) / np.e)
    counts, _ = np.histogram(rows, bins=20, range=(part[0], part[-1] + 1))
    assert ((counts - len(rows) / 20) ** 2 / (len(rows) / 20)).sum() < 50  # chi^2, 19 degrees of freedom: p < 2e-4


def test_a_test_that_was_just_drawn_has_fresh_layouts_of_its_own(monkeypatch):
    """Before the pool has them; and what was the test stays what it was."""
    monkeypatch.setattr(layout_pool, "SEEDS_WITH_LAYOUTS", (*SEEDS_WITH_LAYOUTS, 999_983))
    assert [SHIPPED.row(999_983, episode, solvable=True) for episode in range(3)] == [-1] * 3
    world = TaskVectorEnv(1, task=ReachObstaclesTask)
    for found, wanted in zip(played(world, 999_983, 1), drawn(999_983, 1), strict=True):
        np.testing.assert_array_equal(found[0], wanted)


@pytest.mark.slow
def test_a_new_test_gets_a_part_of_the_pool_and_all_others_are_kept(tmp_path):
    pool = make_layout_pool.with_seeds(dataclasses.replace(SHIPPED), [DEVELOPMENT_SEED, 999_983], processes=1, size=3)
    assert {name: len(rows) for name, rows in pool.parts.items()} == {
        str(DEVELOPMENT_SEED): 1000, "999983": 3, **make_layout_pool.SIZES,
    }  # fmt: skip
    for name in (str(DEVELOPMENT_SEED), *PARTS):
        for field in ("targets", "boxes", "feasible", "counts"):
            kept, before = (getattr(of, field)[of.parts[name]] for of in (pool, SHIPPED))
            np.testing.assert_array_equal(kept, before)
    target, boxes, _ = drawn(999_983, 2)
    np.testing.assert_array_equal(pool.targets[pool.parts["999983"][2]], np.float32(target))
    np.testing.assert_array_equal(pool.boxes[pool.parts["999983"][2]], np.float32(boxes))
    write_pool(pool, tmp_path / "pool.npz")
    assert read_pool(tmp_path / "pool.npz").names == pool.names


def test_an_episode_is_the_same_in_any_company():
    numbers = {"seed": [5, 10**9 + 1, TEST_SEED, 10**8, 2**32 + 5, 5], "episode": [3, 0, 4, 7, 3, 0]}
    together = played(TaskVectorEnv(6, task=ReachObstaclesTask, autoreset_mode="disabled"), **numbers)
    for i, (seed, episode) in enumerate(zip(*numbers.values(), strict=True)):
        alone = played(gymnasium.make_vec("armctl/ArmReachObstacles-v0", num_envs=1), [seed], [episode])
        for a, b in zip(alone, together, strict=True):
            np.testing.assert_array_equal(a[0], b[i])


def test_all_layouts_are_drawn_if_they_need_not_be_solvable():
    seed = next(
        seed for seed in range(10**9, 10**9 + 10**5) if not SHIPPED.feasible[SHIPPED.row(seed, 0, solvable=False)]
    )
    world = TaskVectorEnv(1, task=ReachObstaclesTask, solvable=False)
    assert not world.reset(seed=seed)[1]["feasible"].any()
    assert TaskVectorEnv(1, task=ReachObstaclesTask).reset(seed=seed)[1]["feasible"].all()


@pytest.mark.parametrize(
    "rng",
    [
        lambda: np.random.default_rng(3),
        lambda: np.random.default_rng((3, 1, 4)),
        lambda: np.random.default_rng((3, 1)).spawn(1)[0],
        lambda: np.random.Generator(np.random.MT19937((3, 1))),
    ],
)
def test_other_generators_draw_for_themselves(rng):
    task = ReachObstaclesTask(2, ReachObstaclesOptions())
    task.reset(np.array([1], dtype=np.int32), [rng()])
    layout, _ = sample_certified_layout(rng(), *tools(), 0.05, solvable=True)
    np.testing.assert_array_equal(task._targets[1], layout.target)
    used = np.random.default_rng((3, 1))
    task.reset(np.array([0], dtype=np.int32), [used])
    from_pool = task._targets[0].copy()
    used.random()
    task.reset(np.array([0], dtype=np.int32), [used])
    assert not np.array_equal(task._targets[0], from_pool)


def test_another_arm_or_tolerance_never_uses_the_pool():
    ur5 = load_arm("ur5")
    assert pool_for(ur5, 0.05) is not None
    assert pool_for(ur5, 0.04) is None
    wider = dataclasses.replace(ur5.capsules[2], radius=ur5.capsules[2].radius + 1e-4)
    limits = dataclasses.replace(ur5.limits, lower=ur5.limits.lower + 1e-3)
    for changed in (
        load_arm("ur3"), load_arm("ur5", home=ur5.home + 1e-3), dataclasses.replace(ur5, limits=limits),
        dataclasses.replace(ur5, capsules=(*ur5.capsules[:2], wider, *ur5.capsules[3:])),
        dataclasses.replace(ur5, collision_pairs=ur5.collision_pairs[1:]),
        dataclasses.replace(ur5, urdf=ur5.urdf.replace('mass value="4.0"', 'mass value="4.1"')),
    ):  # fmt: skip
        assert pool_for(changed, 0.05) is None


def test_rounding_and_the_sense_of_a_capsule_make_no_other_arm():
    ur5 = load_arm("ur5")
    capsules = tuple(
        dataclasses.replace(one, start=tuple(np.add(one.end, 1e-12)), end=one.start) for one in ur5.capsules
    )
    home = np.where(ur5.home == 0, -0.0, ur5.home)
    assert robot_digest(dataclasses.replace(ur5, capsules=capsules, home=home)) == robot_digest(ur5)


def test_another_tolerance_is_planned_at_reset():
    world = TaskVectorEnv(1, task=ReachObstaclesTask, tolerance=0.04)
    observation, _ = world.reset(seed=3)
    layout, _ = sample_certified_layout(np.random.default_rng((3, 0)), *tools(), 0.04, solvable=True)
    np.testing.assert_array_equal(observation[0, 9:12], layout.target.astype(np.float32))


@pytest.mark.parametrize("solvable", [True, False])
def test_resets_take_less_than_a_millisecond_a_world(solvable):
    worlds = TaskVectorEnv(256, task=ReachObstaclesTask, solvable=solvable)
    worlds.reset(seed=0)
    begin = time.process_time()
    worlds.reset(seed=10_000)
    assert (time.process_time() - begin) / 256 <= 0.001


def test_boxes_of_the_last_episode_leave_nothing_behind():
    """A world that was reset twice is the one that was reset once, to the last number."""
    worlds = TaskVectorEnv(2, task=ReachObstaclesTask)
    for seed in ([1, 3], [2, 2]):
        worlds.reset(seed=seed)
    fresh = TaskVectorEnv(1, task=ReachObstaclesTask)
    fresh.reset(seed=2)
    for name, values in worlds.task.simulation.live_arrays.items():
        np.testing.assert_array_equal(values[0], values[1], err_msg=name)
        np.testing.assert_array_equal(values[0], fresh.task.simulation.live_arrays[name][0], err_msg=name)
    assert isinstance(worlds.task.boxes(0), Boxes)

"""Blocks of many episodes in the store: whatever is a block or rows, the store holds the same."""

import numpy as np
import pytest

from armctl.core.errors import ResultsError
from armctl.episodes import blocks, packing
from armctl.episodes.rows import NULLABLE
from armctl.episodes.store import Store
from armctl.episodes.stored import blocks_in, origin_of, read_store, rows_in, sizes_in

from ..made_up_episodes import OWN, played, same
from ..stores import one_cell, read_cell
from .stored import contents, edit, write

FOUND = list(played(12, "ba"))


@pytest.fixture(autouse=True)
def in_block(monkeypatch):
    monkeypatch.setattr(blocks, "EPISODES", 5)


@pytest.fixture
def made_up(tmp_path):
    write(tmp_path, FOUND)
    return tmp_path


def counts(store):
    """Numbers of a store's blocks and rows."""
    return len([*blocks_in(store.file, 0)]), len([*rows_in(store.file, 0)])


def test_full_blocks_are_made_while_episodes_are_written(tmp_path):
    with Store(tmp_path) as store:
        store.open(OWN["seed"], ["none"])
        for begun in range(2):
            cell = store.cell("none", OWN, 12)
            for result in FOUND[12 * begun : 12 * begun + 12]:
                cell.write(result)
            assert counts(store) == [(2, 2), (4, 4)][begun]
            same(cell.episodes().sorted("ba"), FOUND[: 12 * begun + 12])
    same(read_cell(tmp_path).episodes.sorted("ba"), FOUND)


def test_a_block_is_made_of_the_first_rows_and_of_no_fewer(tmp_path, monkeypatch):
    """After a block could not be made, and after rows were removed."""
    with one_cell(tmp_path, OWN, 12) as cell, monkeypatch.context() as change:
        change.setattr(packing, "LARGEST_LISTS", 0)
        for result in FOUND[:9]:
            cell.write(result)
    with Store(tmp_path) as store:
        store.open(OWN["seed"], ["none"])
        cell = store.cell("none", OWN, 12)
        cell.write(FOUND[9])
        assert counts(store) == (1, 5)
        cell.forget(np.arange(5, 10))
        for result in FOUND[10:15]:
            cell.write(result)
        assert counts(store) == (2, 0)
        for result in FOUND[15:17]:
            cell.write(result)
        cell.forget(np.array([4]))
        for result in FOUND[17:20]:
            cell.write(result)
        assert counts(store) == (2, 4)
    same(read_cell(tmp_path).episodes.sorted("ba"), [*FOUND[:4], *FOUND[10:16], *FOUND[17:20]])


def test_what_would_be_too_large_or_cannot_be_written_stays_rows(tmp_path, monkeypatch):
    monkeypatch.setattr(packing, "LARGEST_LISTS", 100)
    with Store(tmp_path) as store:
        store.open(OWN["seed"], ["none"])
        cell = store.cell("none", OWN, 12)
        for result in FOUND[:12]:
            cell.write(result)
        assert counts(store) == (0, 12)
        monkeypatch.setattr(packing, "LARGEST_LISTS", 2**27)
        monkeypatch.setattr(packing, "INSERT_BLOCK", "INSERT INTO nothing VALUES (0)")
        for result in FOUND[12:18]:
            cell.write(result)
        assert counts(store) == (0, 18)
        monkeypatch.undo()
    same(read_cell(tmp_path).episodes, FOUND[:18])


def test_episodes_are_removed_from_blocks_and_rows(made_up):
    with one_cell(made_up, OWN, 12) as cell:
        cell.forget(np.array([0, 1, 2, 3, 4, 11]))
        kept = [result for result in FOUND if 4 < result.episode < 11]
        same(cell.kept.sorted("ba"), kept)
    same(read_cell(made_up).episodes.sorted("ba"), kept)
    with one_cell(made_up, OWN, 12) as cell:
        cell.finish({}, [], without=["b", "c"])
    same(read_cell(made_up).episodes, [result for result in kept if result.policy == "a"])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ("energy = zeroblob(length(energy))", "a block of episodes was changed"),
        ("energy = NULL", "a block of episodes was changed"),
        ("energy = x'00'", "a block of episodes was changed"),
        ("contacts = x''", "a block of episodes was changed"),
        ("policy = outcome", "a block of episodes was changed"),
        ("policy = zeroblob(1 + length(policy))", "a block of episodes was changed"),
        ("run = x'7F7F7F7F7F'", "is out of bounds"),
        ("run = x'FFFFFFFFFF'", "a text that is not there"),
        ("episodes = 4", "a block of episodes was changed"),
        ("episodes = 0", "a block of episodes was changed"),
        ("decisions = -1", "do not fit the length"),
        (f"episodes = {2**62}", "a block of episodes was changed"),
        ("decisions = decisions + 1", "do not fit the length"),
        ("decisions = 0", "do not fit the length"),
        (f"decisions = {2**62}", "do not fit the length"),
        ("decision_ms = zeroblob(length(decision_ms))", "a block of episodes was changed"),
        ("reward_terms = x'00'", "a block of episodes was changed"),
        ("policy = zeroblob(9), episodes = 10001", "a block of episodes was changed"),
        ("checksum = checksum + 1", "a block of episodes was changed"),
        ("cell = 1", "its table episode_block has 1 rows of other cells"),
    ],
)
def test_what_another_program_changed_is_told_and_nothing_is_touched(made_up, change, says):
    edit(made_up, f"UPDATE episode_block SET {change} WHERE rowid = 2")
    before = contents(made_up)
    for use in (read_store, lambda folder: one_cell(folder, OWN, 12).__enter__()):
        with pytest.raises(ResultsError, match=rf"results\.sqlite is damaged .*{says}"):
            use(made_up)
    assert contents(made_up) == before


def test_a_block_without_episodes_is_told(made_up):
    edit(
        made_up,
        "DELETE FROM episode_row",
        "DELETE FROM episode_block WHERE rowid > 1",
        "UPDATE episode_block SET episodes = 0",
    )
    with pytest.raises(ResultsError, match="a block of episodes was changed"):
        read_store(made_up)


def test_few_bytes_ask_for_little_memory(made_up):
    """Blocks that claim more episodes than their other columns hold are told before there is memory for all of them."""
    with Store(None) as store:
        store.open(OWN["seed"], ["none"])
        store.cell("none", OWN, 12)
        names = [name for name in blocks.BLOCK_COLUMNS if name not in NULLABLE]
        values = [10_000, 0, *([b""] * (len(names) - 3)), 0]
        values[names.index("policy")] = bytes(10_000)
        query = f"INSERT INTO episode_block (cell, {', '.join(names)}) VALUES (0, {', '.join('?' * len(names))})"
        store.file.executemany(query, [values] * 100)
        assert sizes_in(store.file, 0).episodes == 100


def test_forged_numbers_of_rewards_are_told(made_up, monkeypatch):
    """Too few in one block and too many in another one, with right checksums."""
    with Store(made_up) as store:
        store.open(OWN["seed"], ["none"])
        origin, rows = origin_of(OWN, [*store.texts]), [*blocks_in(store.file, 0, ("rowid", *blocks.BLOCK_COLUMNS))]
        for change, (place, *block) in zip((-1, 1), rows, strict=False):
            columns = blocks.columns_of_block(block, origin)
            columns["reward_terms"] = np.resize(columns["reward_terms"], len(columns["reward_terms"]) + change)
            forged = blocks.block_of(columns, origin)
            names = ", ".join(blocks.BLOCK_COLUMNS)
            store.file.execute("DELETE FROM episode_block WHERE rowid = ?", (place,))
            store.file.execute(
                f"INSERT INTO episode_block (cell, {names}) VALUES (0, {', '.join('?' * len(forged))})", forged
            )
    with pytest.raises(ResultsError, match="too few or too many reward terms"):
        read_store(made_up)


def test_an_episode_is_in_one_block(made_up):
    columns = ", ".join(("cell", *blocks.BLOCK_COLUMNS))
    edit(made_up, f"INSERT INTO episode_block ({columns}) SELECT {columns} FROM episode_block WHERE rowid = 1")
    with pytest.raises(ResultsError, match="an episode for the second time"):
        read_store(made_up)


def test_a_block_belongs_to_its_cell(tmp_path):
    with Store(tmp_path) as store:
        store.open(OWN["seed"], ["one", "other"])
        one, other = store.cell("one", OWN, 12), store.cell("other", OWN | {"env_options": {"x": 1}}, 12)
        for result in FOUND[:5]:
            one.write(result)
            other.write(result)
    edit(tmp_path, "UPDATE episode_block SET cell = 1 - cell")
    with pytest.raises(ResultsError, match="was changed, or belongs to another comparison"):
        read_store(tmp_path)

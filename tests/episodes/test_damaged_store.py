"""What was damaged, changed by another program or forged is told, and nothing is touched."""

import math
from dataclasses import replace

import numpy as np
import pytest

from armctl.core.errors import ResultsError
from armctl.core.files import sealed
from armctl.episodes import blocks
from armctl.episodes.database import FORMAT, schema
from armctl.episodes.rows import SINCE_FORMAT_2
from armctl.episodes.store import Store
from armctl.episodes.stored import STORE, read_store

from ..made_up_episodes import OWN, played, same
from ..stores import one_cell, read_cell
from .stored import contents, edit, write


def resume(folder):
    with one_cell(folder, OWN, 12):
        pass


@pytest.fixture
def made_up(tmp_path, request, monkeypatch):
    monkeypatch.setattr(blocks, "EPISODES", getattr(request, "param", blocks.EPISODES))
    write(tmp_path, played(12, "ba"))
    return tmp_path


@pytest.mark.parametrize(
    ("command", "says"),
    [
        ("UPDATE episode_row SET energy = energy + 1e-9 WHERE rowid = 3", "an episode was changed"),
        ("UPDATE episode_row SET contacts = NULL WHERE rowid = 1", "an episode was changed"),
        ("UPDATE episode_row SET feasible = 1 - feasible WHERE rowid = 2", "an episode was changed"),
        ("UPDATE episode_row SET policy = outcome, episode = 77 WHERE rowid = 1", "an episode was changed"),
        ("UPDATE episode_row SET episode = 99 WHERE rowid = 1", "an episode was changed"),
        (
            "UPDATE episode_row SET decision_ms = zeroblob(length(decision_ms)) WHERE rowid = 4",
            "an episode was changed",
        ),
        ("UPDATE episode_row SET decision_ms = x'00' WHERE rowid = 4", "an episode was changed"),
        ("UPDATE episode_row SET reward_terms = x'' WHERE rowid = 4", "an episode was changed"),
        ("UPDATE episode_row SET run = 10000", "is out of bounds"),
        ("UPDATE episode_row SET run = -1", "a text that is not there"),
        ("UPDATE episode_row SET cell = 1 WHERE rowid = 4", "its table episode_row has 1 rows of other cells"),
        ("UPDATE text SET text = text || 'x' WHERE id = 0", "an episode was changed"),
        ("UPDATE text SET id = 99 WHERE id = 0", "not numbered"),
        ("UPDATE cell SET identity = replace(identity, ': 3', ': 4')", "checksum"),
        ("UPDATE cell SET identity = '[]'", "checksum"),
        ("DELETE FROM cell", "its table episode_row has 24 rows of other cells"),
        ("INSERT INTO run VALUES (0, '{}')", "checksum"),
        (f"INSERT INTO run VALUES (0, '{sealed({'id': 1})}')", "validation errors"),
        ("CREATE TABLE more (x)", "does not have the tables"),
        ("CREATE TRIGGER late AFTER DELETE ON run BEGIN DELETE FROM episode_row; END", "does not have the tables"),
        ("CREATE VIEW extra AS SELECT * FROM episode_row", "does not have the tables"),
        ("ALTER TABLE episode_row DROP COLUMN energy", "does not have the tables"),
        (f"PRAGMA user_version = {FORMAT + 1}", f"format {FORMAT + 1}"),
    ],
)
def test_what_another_program_changed_is_told_and_nothing_is_touched(made_up, command, says):
    edit(made_up, command)
    before = contents(made_up)
    for use in (read_store, resume):
        with pytest.raises(ResultsError, match=rf"results\.sqlite is damaged .*{says}"):
            use(made_up)
    assert contents(made_up) == before
    write(made_up, [])


@pytest.mark.parametrize("number", [1, 2])
def test_a_store_of_an_older_format_is_read_and_not_added_to(tmp_path, number):
    unknown = dict.fromkeys(SINCE_FORMAT_2, math.nan) if number == 1 else {}
    episodes = [replace(one, metrics=replace(one.metrics, **unknown)) for one in played(3)]
    write(tmp_path, episodes)
    changes = [f"ALTER TABLE episode_row DROP COLUMN {name}" for name in unknown]
    changes += ["ALTER TABLE episode_row RENAME TO episode", "DROP TABLE episode_block"]
    edit(tmp_path, *changes, *with_sql("""replace(sql, '"', '')"""), f"PRAGMA user_version = {number}")
    same(read_cell(tmp_path).episodes, episodes)
    with pytest.raises(ResultsError, match=f"results of format {number}, which can be read, but not added to"):
        resume(tmp_path)
    edit(tmp_path, "UPDATE episode SET energy = energy + 1e-9 WHERE rowid = 2")
    with pytest.raises(ResultsError, match="an episode was changed"):
        read_store(tmp_path)


@pytest.mark.parametrize("name", SINCE_FORMAT_2)
def test_a_jerk_that_is_removed_or_added_is_told(made_up, name):
    edit(made_up, f"UPDATE episode_row SET {name} = CASE WHEN {name} IS NULL THEN 1.0 END WHERE rowid = 2")
    with pytest.raises(ResultsError, match="an episode was changed"):
        read_store(made_up)


def test_a_trigger_with_the_name_of_a_table_is_told(made_up, tmp_path_factory):
    other, trigger = (
        tmp_path_factory.mktemp("other"),
        "AFTER UPDATE OF facts ON cell BEGIN DELETE FROM episode_row; END",
    )
    tables = schema()
    made = [*tables.values()]
    made.insert([*tables].index("episode_row"), f"CREATE TRIGGER episode_row {trigger}")
    copies = [f"INSERT INTO {name} SELECT * FROM whole.{name}" for name in tables]
    edit(other, f"PRAGMA user_version = {FORMAT}", *made, f"ATTACH '{made_up / STORE}' AS whole", *copies)
    with pytest.raises(ResultsError, match="does not have the tables"):
        read_store(other)


@pytest.mark.slow
def test_a_zero_that_becomes_a_one_is_told(tmp_path):
    """By one bit of its type, in the row or in the index: the number of a cell, by which its rows are found."""
    with Store(tmp_path) as store:
        store.open(OWN["seed"], ["one", "other"])
        for name, options in {"one": {}, "other": {"x": 1}}.items():
            cell = store.cell(name, OWN | {"env_options": options}, 12)
            for result in played(4, "ba"):
                cell.write(result)
    whole, refused = (tmp_path / STORE).read_bytes(), 0
    for place in (i for i, byte in enumerate(whole) if byte == 8):
        (tmp_path / STORE).write_bytes(whole[:place] + bytes([9]) + whole[place + 1 :])
        try:
            for stored in read_store(tmp_path).cells.values():
                same(stored.episodes.sorted("ba"), list(played(4, "ba")))
        except ResultsError:
            refused += 1
    assert refused > 50


def test_values_of_other_types_are_told(made_up):
    """As only somebody can write them who changes the tables and changes them back."""
    edit(made_up, *with_sql("replace(sql, ' STRICT', '')", "episode_row"))
    edit(made_up, "UPDATE episode_row SET energy = 'much' WHERE rowid = 1")
    edit(made_up, *with_sql("sql || ' STRICT'", "episode_row"))
    with pytest.raises(ResultsError, match=r"non-REAL value in episode_row\.energy"):
        read_store(made_up)


def with_sql(sql, name="episode"):
    """Commands that change the SQL of a table without a check."""
    change = f"UPDATE sqlite_schema SET sql = {sql} WHERE name = '{name}'"
    return "PRAGMA writable_schema = ON", change, "PRAGMA writable_schema = RESET"


@pytest.mark.slow
@pytest.mark.parametrize("made_up", [blocks.EPISODES, 7], indirect=True)
def test_any_bytes_are_refused_or_change_nothing(made_up, sized):
    whole, rng, refused = (made_up / STORE).read_bytes(), np.random.default_rng(0), 0
    contents = [b"", b"SQLite format 3\0", *(whole[:end] for end in range(1, len(whole), 2_003))]
    places = rng.integers(0, len(whole), sized(50, 200)).tolist()
    contents += [whole[:at] + bytes([whole[at] ^ int(rng.integers(1, 256))]) + whole[at + 1 :] for at in places]
    for content in contents:
        (made_up / STORE).write_bytes(content)
        try:
            same(read_cell(made_up).episodes.sorted("ba"), list(played(12, "ba")))
        except ResultsError as error:
            refused += "is damaged" in str(error)
    assert refused > sized(10, 40)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"policy": "c"}, "not of this comparison"),
        ({"episode": -1}, "-1 is not the number"),
        *(({"total_reward": value}, "return has") for value in (math.inf, math.nan, 1e101, -1e308)),
        *(({"reward_terms": {"step": 0.0, "x": value}}, "reward_terms has") for value in (math.inf, math.nan, -1e101)),
        ({"decision_ms": np.array([math.nan, 1.0]), "length": 2}, "no times"),
        ({"decision_ms": np.array([1.0, -1.0]), "length": 2}, "no times"),
        ({"decision_ms": np.array([1.0, math.inf]), "length": 2}, "no times"),
        ({"decision_ms": np.array([]), "length": 0}, "without decision times"),
        ({"length": 99}, "do not fit the length"),
        ({"length": -1}, "do not fit the length"),
        ({"reset_ms": -1.0}, "reset_ms that is no time"),
    ],
)
@pytest.mark.parametrize("in_block", [blocks.EPISODES, 4])
def test_what_no_episode_can_be_is_told(tmp_path, change, says, in_block, monkeypatch):
    """Though all checksums are right, as whoever means harm would write it."""
    monkeypatch.setattr(blocks, "EPISODES", in_block)
    found = list(played(12, "ba"))
    found[5] = replace(found[5], **change)
    write(tmp_path, found)
    with pytest.raises(ResultsError, match=says):
        read_store(tmp_path)


@pytest.mark.parametrize("identity", [{}, {"env": "x", "seed": 3}, {"env": 3, "seed": [], "policies": None}])
def test_an_identity_that_is_none_is_told(tmp_path, identity):
    write(tmp_path, [], OWN)
    edit(tmp_path, f"UPDATE cell SET identity = '{sealed(identity)}'")
    with pytest.raises(ResultsError, match="is damaged"):
        read_store(tmp_path)


def test_an_episode_has_one_row(made_up):
    with one_cell(made_up, OWN, 12) as store:
        store.write(next(played(1, "b")))
        with pytest.raises(ResultsError, match="UNIQUE"):
            store.finish({}, [])

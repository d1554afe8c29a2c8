"""What a Parquet file of episodes says is what was written, or it is refused."""

import math
import sys
from dataclasses import fields, replace

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from armctl.core.errors import ConfigurationError, ResultsError
from armctl.core.files import digest
from armctl.episodes import parquet_files as episodes_parquet
from armctl.episodes.csv_files import DECISION_COLUMNS, lines, read_csv, row_checksum, write_csv
from armctl.episodes.metrics import Metrics
from armctl.episodes.parquet_files import read_parquet, write_parquet
from armctl.episodes.record import ADDED, COLUMNS, EpisodeResult
from armctl.episodes.store import check_store
from armctl.episodes.table import EpisodeTable

from ..made_up_episodes import OWN, played, same

names = st.text(st.characters(codec="utf-8", exclude_characters="\r\n\0"), max_size=8)
numbers = st.floats()
returns = st.floats(-1e100, 1e100)
counts = st.integers(0, 2**40)
maybe = {int | None: st.none() | counts, bool | None: st.none() | st.booleans()}
metrics = st.builds(
    Metrics, **{one.name: {int: counts, float: numbers}.get(one.type, maybe.get(one.type)) for one in fields(Metrics)}
)


@st.composite
def results(draw):
    times = draw(
        st.lists(st.floats(0, 1e9) | st.just(math.nan) | st.integers(0, 50).map(lambda k: k / 1e4), max_size=9)
    )
    times = np.array([0.1, *times])
    terms = draw(st.dictionaries(names, returns, max_size=3))
    return EpisodeResult(
        draw(st.sampled_from(["a", "b", "\N{CAT FACE}"])), OWN["env"], draw(st.integers(0, 2**62)), OWN["seed"],
        draw(names), draw(maybe[bool | None]), draw(st.booleans()), draw(returns), terms, len(times),
        draw(st.floats(1.0)), draw(numbers), draw(metrics), draw(counts), draw(counts), times, draw(names),
    )  # fmt: skip


@pytest.fixture
def path(tmp_path):
    write_parquet(tmp_path / "episodes.parquet", digest(OWN), EpisodeTable(played(12, "ba")))
    return tmp_path / "episodes.parquet"


def read(path, own=OWN):
    kept = EpisodeTable()
    read_parquet(path, own, kept)
    return kept


@settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(found=st.lists(results(), max_size=7, unique_by=lambda one: (one.policy, one.episode)))
def test_both_kinds_of_files_hold_what_was_written(found, tmp_path, monkeypatch):
    monkeypatch.setattr(episodes_parquet, "ROWS", 3)
    own = OWN | {"policies": ["a", "b", "\N{CAT FACE}"]}
    path, tables, kept = tmp_path / "e.parquet", (tmp_path / "e.csv", tmp_path / "d.csv"), EpisodeTable()
    write_parquet(path, digest(own), EpisodeTable(found))
    same(read(path, own), found)
    write_csv(*tables, digest(own), found)
    read_csv(*tables, own, kept)
    same(kept, found)


def test_others_read_it_with_types(path):
    found, frame = list(played(12, "ba")), pd.read_parquet(path)
    assert frame.columns.tolist() == [*found[0].row(), "decision_ms"]
    assert frame["policy"].tolist() == [one.policy for one in found]
    assert frame["return"].tolist() == [one.total_reward for one in found]
    assert [dict(terms) for terms in frame["reward_terms"]] == [one.reward_terms for one in found]
    np.testing.assert_equal([times.tolist() for times in frame["decision_ms"]], [x.decision_ms.tolist() for x in found])
    assert frame["contacts"].isna().tolist() == [one.metrics.contacts is None for one in found]


def test_a_file_cut_off_anywhere_is_told(path):
    whole = path.read_bytes()
    for end in [*range(0, 40), *range(40, len(whole), 401), *range(len(whole) - 12, len(whole))]:
        path.write_bytes(whole[:end])
        with pytest.raises(ResultsError, match="is damaged"):
            read(path)


def test_a_changed_byte_changes_nothing_or_is_told(path):
    whole, rng = path.read_bytes(), np.random.default_rng(0)
    refused = 0
    for at in rng.integers(0, len(whole), 300).tolist():
        path.write_bytes(whole[:at] + bytes([whole[at] ^ int(rng.integers(1, 256))]) + whole[at + 1 :])
        try:
            same(read(path), list(played(12, "ba")))
        except ResultsError:
            refused += 1
    assert refused > 150


def rewritten(path, change):
    """The file as another program would write it, with all that stands in its metadata."""
    with pq.ParquetFile(path) as file:
        group, about = file.read(), file.metadata.metadata
    changed = change(group)
    pq.write_table(changed.replace_schema_metadata({"armctl": about[b"armctl"]}), path)


def with_column(name, values):
    def change(group):
        at = group.schema.get_field_index(name)
        return group.set_column(
            at, group.schema.field(at), pa.array(values(group[name].to_pylist()), group.schema.field(at).type)
        )

    return change


@pytest.mark.parametrize(
    "change",
    [
        *(
            with_column(name, spoil)
            for name, spoil in [
                ("energy", lambda values: [*values[:-1], values[-1] + 1e-9]),
                ("success", lambda values: [not one for one in values]),
                ("contacts", lambda values: [None, *values[1:]] if values[0] is not None else [0, *values[1:]]),
                ("policy", lambda values: values[::-1]),
                ("episode", lambda values: [values[1], values[0], *values[2:]]),
                ("optimality_gap", lambda values: [0.5] * len(values)),
                ("reward_terms", lambda values: [[("steps", 1.0)], *values[1:]]),
                ("decision_ms", lambda values: [values[0][::-1], *values[1:]]),
                ("run", lambda values: ["x"] * len(values)),
            ]
        ),
        lambda group: group.slice(1),
        lambda group: pa.concat_tables([group, group]),
        lambda group: group.take(list(range(group.num_rows))[::-1]),
    ],
)
def test_what_another_program_changed_is_told(path, change):
    rewritten(path, lambda group: group)
    same(read(path), list(played(12, "ba")))
    rewritten(path, change)
    with pytest.raises(ResultsError, match=r"row group 0 was changed|second time"):
        read(path)


@pytest.mark.parametrize(
    "change",
    [
        lambda group: group.drop_columns(["energy"]),
        lambda group: group.rename_columns(["a", *group.column_names[1:]]),
        lambda group: group.select(group.column_names[::-1]),
        lambda group: group.append_column("more", group["energy"]),
        lambda group: group.set_column(2, "episode", group["episode"].cast(pa.float64())),
    ],
)
def test_other_columns_are_told(path, change):
    rewritten(path, change)
    with pytest.raises(ResultsError, match="does not have the columns policy, env"):
        read(path)


@pytest.mark.parametrize(
    "about", [{}, {"armctl": ""}, {"armctl": "[" * 100_000}, {"armctl": "{}"}, {"armctl": b"\xff"}, {"armctl": "1e999"}]
)
def test_metadata_that_are_none_of_armctl_are_told(path, about):
    pq.write_table(pq.read_table(path).replace_schema_metadata(about), path)
    with pytest.raises(ResultsError, match="is damaged"):
        read(path)


def test_endless_metadata_are_told(path):
    pq.write_table(pq.read_table(path).replace_schema_metadata({"armctl": "x" * 200_000_000}), path)
    with pytest.raises(ResultsError, match="is damaged"):
        read(path)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"policy": "c"}, "not of this comparison"),
        ({"env": "armctl/ArmReach-v1"}, "not of this comparison"),
        ({"seed": 4}, "not of this comparison"),
        ({"length": 99}, "not of this comparison"),
        ({"episode": -1}, "-1 is not the number"),
        ({"total_reward": math.inf}, "return has inf"),
        ({"total_reward": math.nan}, "return has nan"),
        ({"reward_terms": {"step": 0.0, "x": -1e101}}, r"reward_terms has -1e\+101"),
        ({"decision_ms": np.array([math.nan, 1.0]), "length": 2}, "no times"),
        ({"decision_ms": np.array([1.0, -1.0]), "length": 2}, "no times"),
        ({"decision_ms": np.array([1.0, math.inf]), "length": 2}, "infinite"),
        ({"decision_ms": np.array([]), "length": 0}, "without decision times"),
        ({"reset_ms": -1.0}, "reset_ms that is no time"),
    ],
)
def test_what_no_episode_can_be_is_told(path, change, says):
    """Though all checksums are right, as whoever means harm would write it."""
    found = list(played(12, "ba"))
    found[5] = replace(found[5], **change)
    write_parquet(path, digest(OWN), EpisodeTable(found))
    with pytest.raises(ResultsError, match=says):
        read(path)


def test_another_comparison_is_told(path):
    with pytest.raises(ResultsError, match="another comparison"):
        read(path, OWN | {"more": 1})
    for own in ({}, {"env": "x", "seed": 3}, {"env": "x", "seed": [], "policies": None}):
        write_parquet(path, digest(own), EpisodeTable(played(2)))
        with pytest.raises(ResultsError, match="is damaged"):
            read(path, own)


def test_a_row_group_of_too_much_is_told_before_it_is_read(path, monkeypatch):
    monkeypatch.setattr(episodes_parquet, "MOST_VALUES", 300)
    with pytest.raises(ResultsError, match="too large"):
        read(path)


def test_a_long_text_in_each_row_takes_no_memory(path):
    """10,000 rows with a text of a MB, of which the file has one."""
    one = next(played(1))
    long = replace(one, outcome="x" * 10**6, reward_terms={"y" * 10**6: 1.0})
    write_parquet(path, digest(OWN), EpisodeTable(replace(long, episode=k) for k in range(2_000)))
    assert path.stat().st_size < 10**6
    before = pa.total_allocated_bytes()
    peak = pa.default_memory_pool().max_memory()
    found = read(path)
    assert len(found) == 2_000
    assert pa.total_allocated_bytes() == before
    assert pa.default_memory_pool().max_memory() <= max(peak, 10**9)


def test_a_missing_library_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(
        ConfigurationError, match=r"--store parquet\) needs pyarrow: pip install 'armctl-suite\[parquet\]'"
    ):
        check_store("parquet")
    with pytest.raises(ConfigurationError, match="Did you mean 'parquet'"):
        check_store("parkett")


@pytest.mark.parametrize("added", [1, 2])
def test_tables_without_the_columns_of_later_versions_are_read(tmp_path, added):
    columns = [name for name in COLUMNS if name not in ADDED[-added:]]
    own, found = digest(OWN), list(played(3, "ba"))
    rows = [[one.row()[name] for name in columns] for one in found]
    times = [" ".join(map(str, one.decision_ms.tolist())) for one in found]
    (tmp_path / "episodes.csv").write_text(lines([columns, *rows]))
    (tmp_path / "decisions.csv").write_text(
        lines(
            [
                DECISION_COLUMNS,
                *(
                    (one.policy, one.episode, row_checksum(own, row, spent), spent)
                    for one, row, spent in zip(found, rows, times, strict=True)
                ),
            ]
        )
    )
    kept = EpisodeTable()
    read_csv(tmp_path / "episodes.csv", tmp_path / "decisions.csv", OWN, kept)
    assert np.isnan(kept.column("reset_ms")).all()
    assert [one.total_reward for one in kept] == [one.total_reward for one in found]


def test_a_parquet_file_without_the_times_of_resets_is_read(path, monkeypatch):
    found = EpisodeTable(played(12, "ba"))
    monkeypatch.setattr(episodes_parquet._schema, "__defaults__", (episodes_parquet._OLDER,))
    write_parquet(path, digest(OWN), found)
    monkeypatch.undo()
    kept = EpisodeTable()
    read_parquet(path, OWN, kept)
    assert np.isnan(kept.column("reset_ms")).all()
    assert kept.column("total_reward").tolist() == found.column("total_reward").tolist()

"""Tables for other programs say what the episodes say."""

import json
import sys

import numpy as np
import pandas as pd
import pytest

from armctl.core.errors import ConfigurationError
from armctl.episodes import table as tables
from armctl.episodes.output import write_csv, write_parquet
from armctl.episodes.table import EpisodeTable

from ..command_line import armctl
from ..made_up_episodes import played


@pytest.fixture(params=[12, 0])
def results(request):
    return EpisodeTable(played(request.param, "ba"))


def test_a_csv_file_has_a_row_for_each_episode(tmp_path, results):
    episodes, decisions = (pd.read_csv(path) for path in write_csv(tmp_path, results))
    assert episodes.columns.tolist() == results.frame().columns.tolist()
    assert episodes["episode"].tolist() == [one.episode for one in results]
    assert episodes["return"].tolist() == [one.total_reward for one in results]
    assert [json.loads(terms) for terms in episodes["reward_terms"]] == [one.reward_terms for one in results]
    assert decisions[["policy", "episode"]].equals(episodes[["policy", "episode"]])
    times = [[float(one) for one in cell.split()] for cell in decisions["decision_ms"]]
    np.testing.assert_equal(times, [one.decision_ms.tolist() for one in results])


def test_a_parquet_file_has_types(tmp_path, results, monkeypatch):
    monkeypatch.setattr(tables, "AT_ONCE", 7)
    (path,) = write_parquet(tmp_path, results)
    frame = pd.read_parquet(path)
    assert frame.columns.tolist() == [*results.frame().columns, "decision_ms"]
    assert frame["policy"].tolist() == [one.policy for one in results]
    assert frame["return"].tolist() == [one.total_reward for one in results]
    assert [dict(terms) for terms in frame["reward_terms"]] == [one.reward_terms for one in results]
    np.testing.assert_equal([*map(list, frame["decision_ms"])], [one.decision_ms.tolist() for one in results])
    assert frame["contacts"].isna().tolist() == [one.metrics.contacts is None for one in results]


def test_a_missing_library_is_told(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ConfigurationError, match=r"needs pyarrow: pip install 'armctl-suite\[parquet\]'"):
        write_parquet(tmp_path, EpisodeTable())


@pytest.mark.slow
def test_tables_are_written_again_from_any_results_folder(tmp_path):
    options = ["--episodes", "2", "--set", "max_episode_steps=3", "--out", "out"]
    armctl("sweep", "random", "--disturbance", "delay=1", *options, cwd=tmp_path)
    csv = tmp_path / "out" / "episodes.csv"
    before = csv.read_bytes()
    csv.unlink()
    said = armctl("episodes", "out", "--csv", "--parquet", cwd=tmp_path).stdout
    assert csv.read_bytes() == before
    for name in ("episodes.csv", "decisions.csv", "episodes.parquet"):
        assert f"out/{name}" in said
    for table in (pd.read_csv(csv), pd.read_parquet(tmp_path / "out" / "episodes.parquet")):
        assert table["cell"].tolist() == ["none"] * 2 + ["delay-1.0"] * 2
    refused = armctl("episodes", "out", cwd=tmp_path, check=False)
    assert (refused.returncode, "--csv" in refused.stderr) == (2, True)
    (tmp_path / "empty").mkdir()
    assert "holds no results" in armctl("episodes", "empty", "--csv", cwd=tmp_path, check=False).stderr

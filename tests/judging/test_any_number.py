"""Verdicts on trials that are added until it is clear hold at any number of them."""

import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.stats.sequential import ConfidenceSequence

from .written import WINS, judged, rows_of


def test_trials_that_are_added_until_it_is_clear_have_a_test_that_allows_it(tmp_path):
    fixed = judged(tmp_path, rows_of(WINS)).overall
    growing = judged(tmp_path, rows_of(WINS), any_number=True).overall
    assert growing.differences[0].any_number
    assert growing.differences[0].success_p > fixed.differences[0].success_p
    assert "hold at any number of episodes" in growing.verdict.result
    with pytest.raises(ConfigurationError, match="needs pairs, and there are none"):
        judged(tmp_path, rows_of(WINS), any_number=True, unpaired=True)


@pytest.mark.parametrize("keys", ["seed", "task", "later"])
def test_bets_are_in_the_order_in_which_pairs_were_complete(tmp_path, keys):
    """Another order, such as that of seeds, changes what was bet on before with every new trial."""
    rng = np.random.default_rng(1)
    won = rng.random((2, 64)) < [np.where(np.arange(64) < 24, 0.9, 0.4), np.full(64, 0.3)]
    seeds = np.arange(64) if keys == "task" else rng.permutation(64)
    rows = [(f"{'ab'[p]},t{i % 8 if keys == 'task' else 0},{seeds[i]},{int(won[p, i])}", i) for i in range(64)
            for p in range(2)]  # fmt: skip
    if keys == "later":
        rows = [(row, i) for row, i in rows if row[0] == "a"][::-1] + [(row, i) for row, i in rows if row[0] == "b"]
    growing = judged(tmp_path, ["policy,task,seed,success", *(row for row, _ in rows)], any_number=True)
    expected = ConfidenceSequence(won[0].astype(float) - won[1], (-1.0, 1.0)).p()
    assert growing.overall.differences[0].success_p == pytest.approx(expected)


def test_several_trainings_have_no_verdict_at_any_number(tmp_path):
    lines = ["policy,training_seed,episode,success"]
    lines += [f"{policy},{seed},{k},{k % 2}" for policy in "ab" for seed in range(1 + (policy == "b"))
              for k in range(12)]  # fmt: skip
    with pytest.raises(ConfigurationError, match=r"is for one training of each policy, and there are several of b$"):
        judged(tmp_path, lines, any_number=True)


@pytest.mark.parametrize(("column", "names"), [("condition", ("none", "payload-1")), ("task", ("pick", "place"))])
def test_sweeps_and_suites_are_left_out_as_their_tests_are_for_fixed_numbers(tmp_path, column, names):
    lines = [f"policy,{column},episode,success"]
    lines += [f"{policy},{name},{k},{int(k < won - 6 * i)}" for i, name in enumerate(names)
              for policy, won in (("a", 18), ("b", 12)) for k in range(20)]  # fmt: skip
    assert len(judged(tmp_path, lines, learned=("a",)).study) > 1
    (remark,) = judged(tmp_path, lines, learned=("a",), any_number=True).study
    assert "left out: its tests hold for a fixed number of episodes only" in remark.text

import numpy as np
import pandas as pd
import pytest

from armctl.stats import intervals as statistics
from armctl.stats.across_tasks import (
    SELECTING,
    Choice,
    choose,
    improvement,
    leagues,
    mean_over_tasks,
    pairwise_by_task,
    rank,
    rate_of,
    success_profile,
    values_of,
)
from armctl.stats.correction import holm
from armctl.stats.intervals import Estimate, bounded_mean, success_rate
from armctl.stats.paired import mcnemar
from armctl.stats.sequential import block_ends
from armctl.stats.unpaired import newcombe, unconditional

A, B = Choice("a"), Choice("b")


def table(**columns):
    return pd.DataFrame({name: np.asarray(values, dtype=float) for name, values in columns.items()})


def random_tables(seed, settings=3, episodes=20, policies="abcd"):
    rng = np.random.default_rng(seed)
    rates = rng.uniform(0.2, 1, len(policies))
    return {
        str(i): table(**dict(zip(policies, (rng.random((len(policies), episodes)) < rates[:, None]), strict=True)))
        for i in range(settings)
    }


def values(estimate):
    return estimate.value, estimate.low, estimate.high


def test_nobody_is_judged_by_the_episodes_that_he_was_chosen_for():
    success = table(a=[0, 0, 1] * 3, b=[1, 1, 0] * 3)
    choice = choose(success, success, ["a", "b"])
    assert choice == Choice("a", of_several=True)
    assert values_of(success, choice).tolist() == pytest.approx([0, 0, np.nan] * 3, nan_ok=True)
    assert values_of(success[["b"]], choice).isna().all()  # it did not play


def test_who_has_no_rival_is_judged_by_all_episodes():
    success = table(a=[0, 0, 1] * 3, b=[1, 1, 0] * 3)
    alone = choose(success, success, ["b"])
    assert values_of(success, alone).tolist() == [1, 1, 0] * 3
    chosen = choose(success, success, ["a", "b"])
    assert pairwise_by_task({"none": success}, "none", alone, chosen)["none"].episodes == 6
    assert pairwise_by_task({"none": success}, "none", alone, A)["none"].episodes == 9


def test_equal_success_is_decided_by_return_and_then_by_order():
    won = table(a=[1] * 4, b=[1] * 4)
    assert choose(won, table(a=[1] * 4, b=[0, 0, 2, 0]), ["a", "b"]).policy == "b"
    assert choose(won, table(a=[1] * 4, b=[2, 2, 0, 2]), ["a", "b"]).policy == "a"
    assert choose(won, won, ["b", "a"]).policy == "b"
    assert choose(won[:1], won[:1], ["b", "a"]).policy == "b"  # no episode to choose by


@pytest.mark.one_case
@pytest.mark.parametrize("kinds", ["a bcdef", "ab cd"])
@pytest.mark.parametrize("episodes", [50, 1000])
def test_a_choice_costs_neither_the_test_nor_the_interval_anything(kinds, episodes, sized):
    """All are equally good: the test at 5 % errs in 5 % of all cases at most, and the interval holds in 95 %."""
    rng, runs, errors, misses, gains = np.random.default_rng(0), sized(100, 300), 0, 0, []
    for _ in range(runs):
        success = pd.DataFrame(rng.random((episodes, 6)) < 0.8, columns=list("abcdef"), dtype=float)
        choices = [choose(success, success, list(names)) for names in kinds.split()]
        (found,) = pairwise_by_task({"none": success}, "none", *choices).values()
        errors += found.better != 0
        misses += not found.difference.low <= 0 <= found.difference.high
        gains.append(found.difference.value)
    most = 0.05 + 2.5 * (0.05 * 0.95 / runs) ** 0.5
    assert errors / runs <= most
    assert misses / runs <= most
    assert abs(np.mean(gains)) <= 3 * np.std(gains) / runs**0.5


def test_what_stops_early_is_chosen_by_the_first_episodes():
    rng = np.random.default_rng(0)
    success = pd.DataFrame(rng.random((90, 3)) < [0.2, 0.6, 0.9], columns=list("abc"), dtype=float)
    success["a"] = (np.arange(90) < SELECTING) * 1.0
    chosen = [choose(success[:n], success[:n], ["a", "b"], any_number=True) for n in (SELECTING, 50, 90)]
    assert {choice.policy for choice in chosen} == {"a"}
    assert values_of(success, chosen[0]).notna().tolist() == [False] * SELECTING + [True] * (90 - SELECTING)
    alone = choose(success, success, ["c"], any_number=True)
    assert pairwise_by_task({"none": success}, "none", chosen[0], alone)["none"].episodes == 90 - SELECTING
    assert pairwise_by_task({"none": success[:SELECTING]}, "none", chosen[0], alone) == {}


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.6, 0.95])
def test_whoever_stops_at_the_first_claim_errs_seldom(rate, sized):
    """All are equally good: 5 % of all studies claim at any look that one is better, at most."""
    rng, runs, errors, ends = np.random.default_rng(0), sized(20, 30), 0, block_ends(400)[3:]
    for _ in range(runs):
        success = pd.DataFrame(rng.random((400, 6)) < rate, columns=list("abcdef"), dtype=float)
        for n in ends:
            table = success[:n]
            choices = [choose(table, table, list(names), any_number=True) for names in ("ab", "cdef")]
            if pairwise_by_task({"none": table}, "none", *choices)["none"].better:
                errors += 1
                break
    assert errors / runs <= 0.05 + 2.5 * (0.05 * 0.95 / runs) ** 0.5


def test_heads_to_head_are_mirror_images_and_corrected():
    cells = random_tables(1, settings=4)
    one, other = (pairwise_by_task(cells, "0", *sides) for sides in ((A, B), (B, A)))
    for name in cells:
        assert one[name].difference.value == -other[name].difference.value
        assert (one[name].better, one[name].p) == (-other[name].better, other[name].p)
    raw = {name: mcnemar(found.only_classical, found.only_learned) for name, found in one.items()}
    assert one["0"].p == raw.pop("0")
    assert [one[name].p for name in raw] == holm(list(raw.values()))


def test_an_episode_that_one_did_not_play_does_not_count():
    success = table(a=[1, 1, np.nan, 0], b=[0, np.nan, 1, 0])
    found = pairwise_by_task({"none": success}, "none", A, B)["none"]
    assert (found.episodes, found.only_classical, found.only_learned) == (2, 1, 0)
    assert pairwise_by_task({"none": success[1:3]}, "none", A, B) == {}


def test_improvement_is_symmetric_and_half_for_equals():
    cells = random_tables(2)
    one, other = improvement(cells, A, B), improvement(cells, B, A)
    assert one + other == pytest.approx(np.ones(20))
    wins = np.mean([cell.a - cell.b for cell in cells.values()], axis=0)
    assert one == pytest.approx(0.5 + wins / 2)
    assert (improvement(cells, A, A) == 0.5).all()
    assert improvement({}, A, A).tolist() == []


def test_ranks_of_all_average_to_one_half_whatever_their_order():
    cells = random_tables(3)
    ranks = {name: rank(cells, [name]) for name in "abcd"}
    assert np.mean(list(ranks.values()), axis=0) == pytest.approx(np.full(20, 0.5))
    turned = {name: one[list("dbca")].iloc[::-1] for name, one in cells.items()}
    for name, values in ranks.items():
        assert rank(turned, [name])[::-1] == pytest.approx(values)
    best = {"none": table(a=[1] * 20, b=[0] * 20, c=[0] * 20)}
    assert rank(best, ["a"]).tolist() == [1] * 20
    assert rank(best, ["b"]).tolist() == [0.25] * 20
    assert rank(best, ["z"]).tolist() == []


def test_a_mean_over_tasks_is_that_of_one_task_and_narrower_for_several():
    rng = np.random.default_rng(0)
    parts = [(rng.random(n) < rate).astype(float) for n, rate in ((40, 0.3), (60, 0.8))]
    alone = mean_over_tasks(parts[:1])
    assert values(alone) == values(bounded_mean(parts[0], (0.0, 1.0)))
    mean = mean_over_tasks([*parts, np.empty(0)])
    assert mean.value == pytest.approx((parts[0].mean() + parts[1].mean()) / 2)
    assert values(mean_over_tasks(parts[::-1])) == pytest.approx(values(mean), abs=0.005)
    widths = [one.high - one.low for one in (mean, alone, bounded_mean(parts[1], (0.0, 1.0)))]
    assert widths[0] == pytest.approx(np.hypot(widths[1], widths[2]) / 2, rel=0.05)  # far from 0 and 1
    assert mean_over_tasks([]) is None


@pytest.mark.one_case
@pytest.mark.parametrize("tasks", [2, 3, 5, 8])
@pytest.mark.parametrize("rates", ["95 to 100 %", "99 %", "99.9 %", "one of 97 %"])
def test_means_over_tasks_near_one_hundred_percent_miss_on_neither_side(tasks, rates, sized, monkeypatch):
    monkeypatch.setattr(statistics, "DRAWS", 500)
    runs, rng = sized(60, 100), np.random.default_rng(0)
    shares = {
        "95 to 100 %": np.linspace(0.95, 1, tasks), "99 %": np.full(tasks, 0.99), "99.9 %": np.full(tasks, 0.999),
        "one of 97 %": np.r_[0.97, np.ones(tasks - 1)],
    }[rates]  # fmt: skip
    for episodes in (20, 50, 200, 500):
        sizes = np.full(tasks, episodes)
        sizes[0] = 50
        found = [
            mean_over_tasks([np.arange(n) < rng.binomial(n, share) for n, share in zip(sizes, shares, strict=True)])
            for _ in range(runs)
        ]
        misses = np.mean([(one.low > shares.mean(), one.high < shares.mean()) for one in found], axis=0)
        assert max(misses) <= 0.025 + 3 * (0.025 * 0.975 / runs) ** 0.5


def test_profiles_fall_and_lie_in_their_band():
    cells = [Estimate(1.0, 0.8, 1.0), Estimate(0.5, 0.3, 0.7), Estimate(0.0, 0.0, 0.2)]
    shares = success_profile(cells, np.array([0.0, 0.5, 0.75, 1.0]))
    assert [one.value for one in shares] == pytest.approx([1, 2 / 3, 1 / 3, 1 / 3])
    assert all(one.low <= one.value <= one.high for one in shares)


@pytest.mark.one_case
@pytest.mark.parametrize("rates", [(0.99, 0.98), (1.0, 0.97), (0.9, 0.9), (0.6, 0.9)])
def test_intervals_over_tasks_hold_near_one_hundred_percent_where_a_bootstrap_does_not(rates):
    rng, tasks, episodes = np.random.default_rng(0), 3, 20
    truth = 0.5 + (rates[0] - rates[1]) / 2
    holds, resampled = [], []
    for _ in range(200):
        gains = [
            0.5 + ((rng.random(episodes) < rates[0]).astype(float) - (rng.random(episodes) < rates[1])) / 2
            for _ in range(tasks)
        ]
        found = mean_over_tasks(gains)
        holds.append(found.low <= truth <= found.high)
        draws = np.mean([rng.choice(one, (200, episodes)).mean(axis=1) for one in gains], axis=0)
        low, high = np.quantile(draws, (0.025, 0.975))
        resampled.append(low <= truth <= high)
    assert np.mean(holds) >= 0.93
    if rates == (0.99, 0.98):
        assert np.mean(resampled) < 0.9


def test_families_are_compared_only_over_tasks_that_all_of_them_have_played():
    high, low = np.full(20, 0.9), np.full(20, 0.3)
    ranks = {
        "MPC": {"reach": low, "bridge": high, "moving": high},
        "PPO": {"reach": high, "bridge": low, "moving": low},
        "SAC": {"reach": np.full(20, 0.5)},
        "OMPL": {"moving": low, "bridge": low},
        "none": {},
    }
    found = leagues(ranks)
    assert [(league.tasks, list(league.ranks)) for league in found] == [
        (("reach", "bridge", "moving"), ["MPC", "PPO"]),
        (("moving", "bridge"), ["MPC", "PPO", "OMPL"]),
        (("reach",), ["PPO", "SAC", "MPC"]),
    ]
    for league in found:
        for name, mean in league.ranks.items():
            assert mean == mean_over_tasks([ranks[name][task] for task in league.tasks])
    assert leagues({}) == leagues({"none": {}}) == []


def test_a_setting_in_which_no_pair_was_played_costs_no_episode_of_the_others():
    index = pd.RangeIndex(3)
    played = pd.DataFrame({"a": [1.0, 0.0, 1.0], "b": [0.0, 0.0, 1.0]}, index)
    nobody = pd.DataFrame({"a": np.nan, "b": np.nan}, index)
    cells = {"none": played, "noise": nobody}
    assert improvement(cells, Choice("a"), Choice("b")).tolist() == [1.0, 0.5, 0.5]


def test_the_rate_of_a_choice_is_its_share_of_wins_in_the_episodes_that_it_played():
    success = pd.DataFrame({"a": [1.0, 0.0, 1.0, 1.0, np.nan], "b": [0.0] * 5})
    assert rate_of(success, Choice("a")) == success_rate(np.array([True, False, True, True]))
    assert rate_of(success, Choice("b")).value == 0


def test_different_episodes_are_compared_without_pairs():
    cells = random_tables(0, episodes=60)
    cells["0"] = table(a=np.arange(60) < 57, b=np.arange(60) > 5)
    cells["1"] = table(a=np.arange(60) < 55, b=np.r_[np.zeros(50), np.full(10, np.nan)])
    one, other = (pairwise_by_task(cells, "0", *sides, paired=False) for sides in ((A, B), (B, A)))
    for name, pair in one.items():
        a, b = (cells[name][policy].dropna() for policy in "ab")
        assert (pair.wins, pair.sample_sizes) == ((a.sum(), b.sum()), (len(a), len(b)))
        assert pair.difference == newcombe(int(a.sum()), len(a), int(b.sum()), len(b))
        assert values(other[name].difference) == pytest.approx(values(-pair.difference))
        assert other[name].p == pytest.approx(pair.p)
    assert one["0"].p == unconditional(57, 60, 54, 60)
    assert one["1"].better == 1 == -other["1"].better
    assert one["1"].changed == 1 == -other["1"].changed
    assert one["1"].episodes == 50
    expected = [cells["1"]["a"].mean(), -cells["1"]["b"].mean(), -cells["0"]["a"].mean(), cells["0"]["b"].mean()]
    assert one["1"].change.value == pytest.approx(sum(expected))
    never = {"0": cells["0"].assign(b=np.nan)}
    assert pairwise_by_task(never, "0", A, B, paired=False) == {}

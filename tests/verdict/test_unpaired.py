"""What is said of policies that played different episodes."""

import re
from dataclasses import replace

import numpy as np
import pytest

from armctl.episodes.table import EpisodeTable
from armctl.stats.correction import holm_adjusted
from armctl.stats.difference import Scores, difference_between
from armctl.stats.power import episodes_to_detect, episodes_to_show_equivalence
from armctl.stats.unpaired import unconditional
from armctl.study.results import _FACTS
from armctl.verdict.sentences import verdict
from armctl.verdict.summary import summarise
from armctl.verdict.summary_tables import difference_table

from ..made_up_comparison import UNTRAINED_POLICY, facts_of
from .made_up_verdicts import compared, played, summary_of, text_of
from .test_unknown_bounds import episodes


def separate(wins, **known):
    return played(wins, paired=False, **known)


def test_a_winner_is_one_on_different_episodes():
    policies, pairs = separate({"reach_ik": range(390), "reach_ppo": range(340)})
    said = text_of(policies, pairs)
    p = holm_adjusted(pairs)[0].success
    assert p < 0.001
    assert re.match(r"reach_ik is better than reach_ppo: success \+12.5 points .*on different episodes; Holm, \d", said)
    table = difference_table(pairs)
    assert table.title == "Unpaired differences, on different episodes"
    assert table.columns[2].heading == "a won / b won"
    assert table.rows[0][2].text == "390 of 400 / 340 of 400"
    assert "Barnard's exact test" in table.caption
    assert "McNemar" not in table.caption + said
    assert "same episodes" not in table.caption + said


def test_equivalence_and_what_would_resolve_a_difference():
    policies, pairs = separate({"reach_ik": range(398), "reach_ppo": range(397)})
    said = text_of(policies, pairs, margin=0.05)
    assert said.startswith("reach_ik and reach_ppo are equivalent in success within 5 points (on different episodes):")
    policies, pairs = separate({"reach_ik": range(390), "reach_ppo": range(388)})
    (pair,) = pairs
    share = (390 + 388 + 1) / 802
    assert pair.planning_share == share
    needed = max(
        episodes_to_detect(0.02, share, tests=2, paired=False), episodes_to_show_equivalence(0.02, share, paired=False)
    )
    more = needed - 400
    assert f"run about {round(more, 1 - len(str(more))):,} more episodes" in text_of(policies, pairs)


def test_without_success_the_higher_return_is_a_probability():
    rng = np.random.default_rng(0)
    returns = rng.normal(1, 1, 60), rng.normal(0, 3, 90)
    pair = difference_between("bold", "timid", Scores(None, returns), paired=False)
    policies = [summary_of(name, np.ones(60)) for name in ("bold", "timid")]
    said = text_of(policies, [pair])
    assert "has the higher return with a probability of" in said
    assert "(on different episodes, p = " in said
    assert "sign test" not in said + difference_table([pair]).caption
    bounded = difference_between("bold", "timid", Scores(None, returns, None, (-20.0, 20.0)), paired=False)
    assert "(on different episodes" in text_of(policies, [bounded])


def test_all_episodes_of_either_policy_count():
    """A policy that was cut short takes no episodes from the other, as these are other ones anyway."""
    earned = {"long": np.ones(30), "short": np.repeat([0.0, 1.0], 6)}
    won = EpisodeTable(
        replace(result, success=result.total_reward > 0) for name in earned for result in episodes(name, earned[name])
    )
    policies = dict.fromkeys(earned, UNTRAINED_POLICY)
    together, apart = (
        summarise(won, facts_of(policies=policies, planned=30, paired=paired))[1][0] for paired in (True, False)
    )
    assert (together.sample_sizes, apart.sample_sizes) == ((12, 12), (30, 12))
    assert apart.success_p == unconditional(30, 30, 6, 12) < together.success_p


def test_facts_of_older_stores_are_of_pairs():
    known = _FACTS.dump_python(facts_of(return_bounds=None), mode="json")
    assert known.pop("paired") is True
    assert _FACTS.validate_python(known).paired is True
    assert _FACTS.validate_python(known | {"paired": False}).paired is False


@pytest.mark.parametrize("won", [0, 40])
def test_nobody_or_everybody_wins(won):
    wins = np.arange(40) < won
    policies, pairs = compared({"reach_ik": wins, "reach_ppo": wins}, paired=False)
    assert verdict(policies, pairs).result.startswith("Undecided")
    assert ", p = 1 (on different episodes" in verdict(policies, pairs).result

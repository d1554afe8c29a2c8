"""A lead is certain only if it is: simulated with policies that are alike, and with some that differ."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from armctl.stats.leaders import leaders
from armctl.stats.paired import mcnemar

NAMES = ("a", "b", "c")


@dataclass(frozen=True)
class Pair:
    a: str
    b: str
    p: float
    lead: float

    def lead_of(self, policy):
        return self.lead if policy == self.a else -self.lead


def pairwise(success):
    """All pairs of a table (episodes, policies) of 0 and 1."""
    return [
        Pair(
            NAMES[i],
            NAMES[j],
            mcnemar(int((success[:, i] > success[:, j]).sum()), int((success[:, i] < success[:, j]).sum())),
            float((success[:, i] - success[:, j]).mean()),
        )
        for i, j in combinations(range(success.shape[1]), 2)
    ]


def played(rng, rates, episodes):
    return (rng.random((episodes, len(rates))) < rates).astype(float)


def test_the_leader_has_the_highest_success_and_ties_are_named():
    success = np.array([[1, 1, 0]] * 8 + [[0, 0, 0]] * 2, dtype=float)
    leader = leaders({"cell": pairwise(success)})["cell"]
    assert (leader.policy, leader.ties, leader.not_worse) == ("a", ["b"], ["b"])
    assert not leader.certain


def test_a_lead_is_certain_if_all_others_are_significantly_worse():
    success = np.zeros((40, 3))
    success[:, 1] = 1
    leader = leaders({"cell": pairwise(success)})["cell"]
    assert (leader.policy, leader.not_worse, leader.certain) == ("b", [], True)


def test_without_a_test_there_is_no_leader():
    assert leaders({"cell": []}) == {}


def test_policies_alike_lead_certainly_in_at_most_5_percent_of_all_grids(sized):
    rng, grids = np.random.default_rng(1), sized(100, 600)
    wrong = 0
    for _ in range(grids):
        rates = rng.uniform(0.2, 0.95, 9)
        cells = {i: pairwise(played(rng, np.full(3, rate), 60)) for i, rate in enumerate(rates)}
        wrong += any(leader.certain for leader in leaders(cells).values())
    assert wrong <= 0.05 * grids + 3 * np.sqrt(0.05 * 0.95 * grids)


def test_beside_true_leads_few_certain_leads_are_wrong(sized):
    """Half of the cells have a leader by 40 points; in the others, the best two are alike."""
    rng, grids = np.random.default_rng(2), sized(60, 400)
    certain, wrong = [0, 0], 0
    for _ in range(grids):
        cells = {}
        for i in range(8):
            rates = np.array([0.9, 0.5 if i < 4 else 0.9, 0.3])
            cells[i] = pairwise(played(rng, rates, 60))
        for i, leader in leaders(cells).items():
            certain[i >= 4] += leader.certain
            wrong += leader.certain and (i >= 4 or leader.policy != "a")
    assert certain[0] > 0.9 * 4 * grids
    assert wrong <= 0.05 * sum(certain)

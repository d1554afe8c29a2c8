"""What agents stand on: the costs of their teachers and of their tuning, on cards and in what is said of them."""

import functools
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from armctl.agents import Ancestor, read_card
from armctl.agents.costs import COUNTED, UNTRAINED, TrainingCost, TuningCost, mean_cost
from armctl.envs import make_worlds
from armctl.policies import make_policy
from armctl.rl.data.demonstrations import Teacher
from armctl.rl.networks.actor import Actor
from armctl.rl.run.lineage import recorded_tuning, tuning_before
from armctl.rl.run.training import Training
from armctl.training.learners import load_learner, load_recipe
from armctl.training.trials import COLUMNS, add_trial

SHIPPED = Path(str(resources.files("armctl.rl.agents")))
CARDS = sorted(SHIPPED.rglob("*.json"))
TINY: dict[str, Any] = {
    "worlds": 1, "hidden_units": 8, "layers": 1, "features": "plain", "validation_episodes": 1,
    "evaluation_every": 10**6, "demonstrations": 2, "batch_size": 16, "steps": 5,
}  # fmt: skip
COSTS = st.builds(
    TrainingCost, *[st.integers(0, 10**9), st.floats(0, 1e6)], *[st.integers(0, 10**9)] * 3, st.floats(0, 1e6)
)


SHOW = Teacher.show


@functools.cache
def by_checksum():
    return {card.sha256: card for card in map(read_card, CARDS)}


def own(card):
    return {
        "steps": card.training_steps, "minutes": card.training_minutes, "decisions": card.decisions,
        "teacher_queries": card.teacher_queries, "gradient_steps": card.gradient_steps,
        "processor_seconds": card.processor_seconds,
    }  # fmt: skip


def networks_of(card):
    """The checksums of all networks that a card stands on, its own too, by the cards of its teachers."""
    found = {card.sha256}
    for ancestor in card.lineage:
        if ancestor.sha256 is not None:
            found |= networks_of(by_checksum()[ancestor.sha256])
    return found


@pytest.mark.parametrize("path", CARDS, ids=lambda path: path.stem)
def test_a_shipped_agent_costs_what_all_networks_of_its_lineage_did(path):
    card = read_card(path)
    assert (card.teacher is not None) == bool(card.lineage)
    networks = [own(by_checksum()[checksum]) for checksum in networks_of(card)]
    for name in COUNTED:
        values = [costs[name] for costs in networks]
        expected = None if None in values else pytest.approx(sum(values))
        assert getattr(card.cost.total, name) == expected


def test_an_agent_of_two_teachers_is_said_to_stand_on_both():
    said = str(read_card(SHIPPED / "bridge_moving_ppo.json").cost)
    assert said == (
        "22 million decisions (4.01 million its own, 18 million its teachers') and 39,500 gradient steps "
        "(90.7 minutes of processor)"
    )


@given(st.lists(st.tuples(st.sampled_from("abcd"), COSTS), max_size=8), COSTS)
def test_the_cost_of_an_agent_is_the_sum_over_its_distinct_networks(drawn, cost):
    """However often a teacher is met on the way."""
    costs = dict(drawn)
    lineage = [Ancestor(name=f"taught {i}", sha256=key, cost=costs[key]) for i, (key, _) in enumerate(drawn)]
    total = card_of(cost, [*lineage, Ancestor(name="expert", cost=UNTRAINED)]).cost.total
    for name in COUNTED:
        assert getattr(total, name) == pytest.approx(sum(getattr(one, name) for one in (cost, *costs.values())))


def card_of(cost, lineage, **changes):
    card = by_checksum()[read_card(SHIPPED / "reach_ppo.json").sha256]
    counts = {name: getattr(cost, name) for name in COUNTED if name not in ("steps", "minutes")}
    own = {"training_steps": cost.steps, "training_minutes": cost.minutes, "lineage": lineage}
    return card.model_copy(update=counts | own | changes)


def test_what_is_unknown_of_a_teacher_is_unknown_of_the_agent():
    cost = TrainingCost(10, 1.0, 4_000_000, 0, 9, 60.0)
    card = card_of(cost, [Ancestor(name="mine", sha256="a", cost=TrainingCost())])
    assert card.cost.total.decisions is None
    assert str(card.cost) == (
        "4 million decisions and 9 gradient steps (1.0 minutes of processor) of its own, and an unknown number of its "
        "teachers'"
    )


def test_a_shared_teacher_counts_once_in_the_mean_of_trainings():
    teacher = Ancestor(name="teacher", sha256="a", recipe="teacher", cost=TrainingCost(5, 5.0, 100, 0, 5, 50.0))
    tuned = TuningCost(7, 70.0)
    costs = [card_of(TrainingCost(n, 1.0, n, 0, n, 1.0), [teacher], tuning=tuned).cost for n in (10, 20, 30)]
    mean = mean_cost(costs)
    assert (mean.decisions, mean.teachers.decisions, mean.total.decisions) == (20, 100, 120)
    assert mean.tuning == tuned
    assert mean_cost([costs[0], TrainingCost(10, 1.0, 10, 0, 10, 1.0)]).teachers.decisions == 50


def test_the_tuning_of_each_recipe_of_a_lineage_counts_once():
    cost = TrainingCost(1, 1.0, 1, 0, 1, 1.0)
    tunings = {"a": ("one", TuningCost(3, 3.0)), "b": ("one", TuningCost(3, 3.0)), "c": ("two", TuningCost(5, 5.0))}
    lineage = [
        Ancestor(name=name, sha256=name, recipe=recipe, cost=replace(cost, tuning=tuning))
        for name, (recipe, tuning) in tunings.items()
    ]
    assert card_of(cost, lineage, recipe="mine", tuning=TuningCost(11, 11.0)).cost.tuning == TuningCost(19, 19.0)
    assert card_of(cost, lineage, recipe="mine", tuning=None).cost.tuning == TuningCost(8, 8.0)
    assert card_of(cost, [], tuning=None).cost.tuning is None


def train(tmp_path, monkeypatch, teacher, **options):
    monkeypatch.setattr(Training, "_final_evaluation", lambda training: None)
    monkeypatch.setattr(Actor, "export", lambda actor, path: path.write_bytes(b""))
    recipe = load_recipe("reach_bc").changed(
        options=TINY | options, env_options={"max_episode_steps": 10}, teacher=str(teacher)
    )
    return load_learner("bc")(recipe, out=tmp_path / "run" / "reach_bc-0", seed=0, progress=False)


@pytest.mark.slow
def test_a_training_gets_the_lineage_of_its_teacher(tmp_path, monkeypatch):
    """A learned one, whose card has a lineage itself; an expert has been tuned at most."""
    monkeypatch.setattr(Teacher, "show", shown)
    card = train(tmp_path, monkeypatch, "reach_dagger")
    teacher = read_card(SHIPPED / "reach_dagger.json")
    assert [(one.name, one.sha256) for one in card.lineage] == [("reach_dagger", teacher.sha256), ("reach_ik", None)]
    assert card.cost.teachers.decisions == teacher.decisions
    assert card.cost.total.gradient_steps == TINY["steps"] + teacher.gradient_steps
    assert read_card(tmp_path / "run" / "reach_bc-0" / "agent.json").lineage == card.lineage


def test_a_training_by_an_expert_says_how_it_was_tuned(tmp_path, monkeypatch):
    monkeypatch.setattr(Teacher, "show", shown)
    card = train(tmp_path, monkeypatch, "reach_mpc")
    (teacher,) = card.lineage
    assert (teacher.name, teacher.cost.is_untrained, teacher.cost.tuning.trials) == ("reach_mpc", True, 128)
    assert card.cost.teachers is None
    assert card.cost.tuning.trials == 128 + recorded_tuning("reach_bc").trials


def shown(teacher, episodes, seed):
    """Episodes of `reach_ik`, whoever teaches: what is learned is beside the point."""
    teacher.policy = make_policy("reach_ik", teacher.envs)
    return SHOW(teacher, episodes, seed)


def row(**changes):
    return dict.fromkeys(COLUMNS, "") | {"recipe": "mine", "ended": "finished", "minutes": 2.5, "seed": 1} | changes


def test_what_the_ledger_has_tried_before_is_on_the_card(tmp_path):
    """Other seeds of the same recipe are no trials."""
    recipe, folder = load_recipe("reach_ppo").changed(name="mine"), tmp_path / "mine-0"
    assert tuning_before(recipe, 0, folder) is None
    add_trial(tmp_path / "trials.csv", row())
    assert tuning_before(recipe, 0, folder) is None
    for tried in (
        row(changed='{"options.gamma": 0.9}'), row(ended="failed"), row(ended="pruned", minutes=""), row(seed=0),
        row(recipe="other", ended="failed"),
    ):  # fmt: skip
        add_trial(tmp_path / "trials.csv", tried)
    assert tuning_before(recipe, 0, folder) == TuningCost(4, 7.5)
    tuned = recipe.changed(tuned={"trials": 10, "minutes": 60.0})
    assert tuning_before(tuned, 0, folder) == TuningCost(14, 67.5)


@pytest.mark.slow
def test_the_ledger_of_this_repository_tells_of_every_recipe_that_was_tuned():
    assert recorded_tuning("reach_sac").trials >= 26
    assert recorded_tuning("bridge_state_ppo") is None
    for path in CARDS:
        card = read_card(path)
        assert card.tuning == recorded_tuning(card.recipe), f"{path.stem}: run python tools/zoo.py"


def test_an_agent_that_looks_ahead_costs_what_its_network_did_and_the_trials_of_its_options():
    worlds = make_worlds("armctl/BridgeCrossMoving-v0", 1)
    policy: Any = make_policy("bridge_moving_imagined", worlds)
    cost = policy.training_cost
    network = read_card(SHIPPED / "bridge_moving_state_ppo.json").cost
    assert replace(cost, tuning=None) == replace(network, tuning=None)
    own = recorded_tuning("bridge_moving_imagined")
    assert cost.tuning.trials == network.tuning.trials + own.trials
    worlds.close()


def test_the_tuning_of_an_expert_is_said_too(tmp_path):
    worlds = make_worlds("armctl/ArmReach-v0", 1)
    usual: Any = make_policy("reach_mpc", worlds)
    assert str(usual.training_cost.tuning) == "128 recorded trials (61 minutes)"
    file = tmp_path / "mine.toml"
    file.write_text('policy = "reach_mpc"\nenv = "armctl/ArmReach-v0"\ntuned = { trials = 1 }\n')
    tuned: Any = make_policy(str(file), worlds)
    assert str(tuned.training_cost.tuning) == "1 recorded trial"
    assert getattr(make_policy("reach_ik", worlds), "training_cost", None) is None
    worlds.close()

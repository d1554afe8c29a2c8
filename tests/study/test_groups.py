"""Several trainings of one recipe as one learner."""

import json
import shutil

import numpy as np
import pandas as pd
import pytest

import armctl
from armctl.agents import read_card
from armctl.core.errors import ConfigurationError, ResultsError
from armctl.policies import expanded, policy_names, training_card
from armctl.policies.trainings import card_path
from armctl.report import write_report
from armctl.stats.trainings import difference_over_trainings, mean_over_trainings
from armctl.study.results import read_comparison
from armctl.study.sample_size import plan_comparison
from armctl.verdict.tables import Remark

from ..forgery import change_facts

MEMBERS = [f"reach_bc[{seed}]" for seed in (0, 1, 2)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("groups")
    armctl.compare(["reach_ik", "reach_bc[*]"], episodes=12, worlds=12, out=folder)
    return folder


@pytest.fixture(scope="module")
def results(folder):
    return read_comparison(folder)


@pytest.fixture
def runs(tmp_path):
    """A recipe's trainings, as `armctl train` writes them."""
    for seed in range(3):
        made = tmp_path / f"mine-{seed}"
        made.mkdir()
        for suffix in (".json", ".onnx"):
            shutil.copy(card_path(MEMBERS[seed]).with_suffix(suffix), made / f"agent{suffix}")
    return tmp_path


def rewrite(card, **changes):
    card.write_text(json.dumps(json.loads(card.read_text()) | changes))


def test_a_group_is_one_learner_of_several_policies(folder, results):
    rows = pd.read_csv(folder / "episodes.csv")
    assert rows.policy.unique().tolist() == ["reach_ik", *MEMBERS]
    expert, group = results.policies
    assert (group.policy, group.episodes, list(group.trainings)) == ("reach_bc[*]", 12, MEMBERS)
    by_training = rows.groupby("policy").success.mean()
    assert list(group.trainings.values()) == by_training[MEMBERS].tolist()
    scores = np.array([rows[rows.policy == name].success for name in MEMBERS], dtype=float)
    crossed = mean_over_trainings(scores, (0.0, 1.0))
    assert (group.success, group.if_normal) == (crossed.mean, crossed.if_normal)
    assert group.between_seed_std == crossed.between_seed_std
    (pair,) = results.differences
    won = rows[rows.policy == "reach_ik"].success.to_numpy(float)[None]
    assert pair.crossed == difference_over_trainings(won, scores, (0.0, 1.0))
    assert pair.success_p == pair.crossed.p
    assert pair.both_won + pair.only_a + pair.only_b + pair.neither == 12
    assert expert.trainings == {}


def test_a_verdict_tells_a_recipe_from_a_network(results):
    assert "for reach_bc[*] as a recipe (3 trainings)." in str(results.verdict)
    alone = armctl.compare(["reach_ik", "reach_bc[1]"], episodes=10, worlds=10)
    assert "The result holds for reach_bc[1] as one network." in str(alone.verdict)


@pytest.mark.slow
def test_a_group_resumes_and_is_the_same_with_workers(folder, tmp_path, results):
    shutil.copytree(folder, tmp_path / "more")
    again = armctl.compare(["reach_ik", "reach_bc[*]"], episodes=12, worlds=3, workers=2, out=tmp_path / "workers")
    more = armctl.compare(["reach_ik", "reach_bc[*]"], episodes=13, worlds=13, out=tmp_path / "more")
    assert more.resumed == 48
    assert "after an earlier look at 12 episodes" in str(more.verdict)
    assert "earlier look" not in str(again.verdict)
    assert again.differences == results.differences
    assert again.verdict.result == results.verdict.result


def test_a_report_shows_a_group(folder, tmp_path):
    page = write_report(folder, tmp_path / "report.html", video=False).read_text()
    assert "success by training" in page
    assert "<b>reach_bc[*]</b>" in page
    assert "<b>reach_bc[1]</b>" not in page
    assert "armctl compare reach_ik &#39;reach_bc[*]&#39;" in page


def test_two_groups_and_a_baseline(runs, monkeypatch):
    monkeypatch.chdir(runs)
    for seed, path in enumerate(sorted(runs.glob("mine-*/agent.json"))):
        graph = path.with_suffix(".onnx")
        other = card_path("reach_dagger") if seed == 0 else card_path("reach_bc")
        shutil.copy(other.with_suffix(".onnx"), graph)
        rewrite(path, sha256=read_card(other).sha256)
    shutil.rmtree(runs / "mine-2")
    with pytest.raises(ConfigurationError, match="are the same network"):
        armctl.compare(["mine[*]", "reach_bc[*]"], episodes=1)
    made = armctl.compare(["mine[*]", "random", "reach_ik"], episodes=10, worlds=10, baseline="mine[*]")
    assert made.verdict.result.startswith("Undecided between reach_ik and mine[*]: success ")
    assert ". Undecided between mine[*] and random: success +" in made.verdict.context
    assert [pair.crossed is None for pair in made.differences] == [False, False, True]
    # Two trainings that never fail are one in two with a probability of 1/4: that is no proof against random actions.
    assert all(rate == 1 for rate in made.policies[0].trainings.values())
    assert made.policies[1].success.value < 0.5
    assert made.differences[0].success_p > 0.05


@pytest.mark.slow
def test_a_group_in_a_sweep(tmp_path):
    found = armctl.sweep(["reach_bc[*]"], disturbances={"delay": [3]}, episodes=8, worlds=8, out=tmp_path)
    assert found.points.policy.unique().tolist() == ["reach_bc[*]"]
    won = [
        one.episodes.pivot(index="policy", columns="episode", values="success").to_numpy(float)
        for one in (found.comparisons["none"], found.comparisons["delay-3.0"])
    ]
    assert found.points.success.tolist() == pytest.approx([one.mean() for one in won])
    assert found.points.p.tolist() == [1, mean_over_trainings(won[1] - won[0], (-1.0, 1.0)).p]


def test_a_training_by_its_seed():
    assert read_card(training_card("reach_bc[2]")).training_seed == 2
    assert training_card("reach_bc[0]") == card_path("reach_bc")
    assert card_path("reach_bc[1]").with_suffix(".onnx").is_file()
    assert not any("[" in name for name in policy_names())
    with pytest.raises(ConfigurationError, match=r"no training 'reach_bc\[7\]'. Known: reach_bc\[0\], reach_bc\[1\]"):
        armctl.evaluate("reach_bc[7]", episodes=1)
    with pytest.raises(ConfigurationError, match=r"reach_bc\[\*\] is 3 trainings, which compare and sweep take"):
        armctl.evaluate("reach_bc[*]", episodes=1)


def test_a_single_training_is_no_group(runs):
    for seed in (1, 2):
        shutil.rmtree(runs / f"mine-{seed}")
    made = armctl.compare([f"{runs}/mine[*]", "random"], episodes=2, worlds=2)
    assert [policy.policy for policy in made.policies] == [f"{runs}/mine[0]", "random"]
    assert any("a single training, which says nothing of others" in note for note in made.notes)


@pytest.mark.parametrize(
    ("given", "why"),
    [
        (["reach_bc", "reach_bc[*]"], "are the same network"),
        (["reach_bc[1]", "reach_bc[*]"], "one of a group"),
        (["reach_bc[*]", "reach_bc[1]"], "one of a group"),
        (["reach_bc[*]", "reach_bc[*]"], "only once"),
        (["reach_ik[*]"], "no trainings reach_ik"),
        (["nowhere/mine[*]"], "no trainings nowhere/mine"),
        (["[*]"], "no policy"),
        (["reach_bc[x]"], "no policy"),
        (["reach_bc[-1]"], "no policy"),
        (["a\0b[*]"], "no trainings"),
        (["/[*]"], "no trainings"),
    ],
)
def test_what_is_no_group_is_refused(given, why):
    with pytest.raises(ConfigurationError, match=why):
        armctl.compare(given, episodes=1)


def test_trainings_of_ones_own(runs, monkeypatch):
    monkeypatch.chdir(runs)
    players, groups = expanded({"mine[*]": "mine[*]"})
    assert groups == {"mine[*]": ["mine[0]", "mine[1]", "mine[2]"]}
    assert training_card("mine[1]").parent.name == "mine-1"
    assert list(players) == groups["mine[*]"]
    rewrite(runs / "mine-2" / "agent.json", learner="ppo")
    with pytest.raises(ConfigurationError, match=r"mine-2.agent.json has the learner 'ppo' instead of 'bc'"):
        expanded({"mine[*]": "mine[*]"})
    rewrite(runs / "mine-2" / "agent.json", learner="bc", env_options={"robot": "ur10"})
    with pytest.raises(ConfigurationError, match="the robot 'ur10' instead of None"):
        expanded({"mine[*]": "mine[*]"})
    rewrite(runs / "mine-2" / "agent.json", env_options={}, training_seed=1)
    with pytest.raises(ConfigurationError, match="both of training seed 1"):
        expanded({"mine[*]": "mine[*]"})


def test_options_that_only_older_cards_have_do_not_count(runs, monkeypatch):
    monkeypatch.chdir(runs)
    card = runs / "mine-2" / "agent.json"
    options = json.loads(card.read_text())["learner_options"]
    assert (options["features"], "turned" in options) == ("invariant", False)  # the first one says true, true
    rewrite(card, learner_options=options | {"layers": 5})
    with pytest.raises(ConfigurationError, match="the layers 5 instead of 3"):
        expanded({"mine[*]": "mine[*]"})


@pytest.mark.parametrize(
    "groups",
    [
        {"reach_bc[*]": []},
        {"x": ["elsewhere"]},
        {"x": [MEMBERS[0], MEMBERS[0]]},
        {"x": [MEMBERS[0]]},
        {"x": "text"},
    ],
)
def test_groups_that_do_not_belong_to_the_episodes_are_noticed(folder, tmp_path, groups):
    shutil.copytree(folder, tmp_path / "forged")
    change_facts(tmp_path / "forged", lambda facts: facts.update(groups=groups))
    with pytest.raises(ResultsError):
        read_comparison(tmp_path / "forged")


@pytest.mark.slow
def test_a_plan_leaves_out_groups(folder, tmp_path):
    with pytest.raises(ResultsError, match="more trainings tell more"):
        plan_comparison(0.02, pilot=folder)
    armctl.compare(["reach_ik", "random", "reach_bc[*]"], episodes=10, worlds=10, out=tmp_path)
    document = plan_comparison(0.02, pilot=tmp_path)
    assert [record["pair"] for record in document.tables[0].records] == ["reach_ik - random"]
    said = " ".join(part.text for part in document.parts if isinstance(part, Remark))
    assert "Left out: reach_ik - reach_bc[*], random - reach_bc[*]." in said

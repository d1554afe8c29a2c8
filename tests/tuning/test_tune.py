"""Tunings, of small recipes and few episodes: everything else is as for large ones."""

import dataclasses
import json
import multiprocessing
import os
import signal
import tomllib
from pathlib import Path

import pandas as pd
import pytest
from optuna.trial import TrialState

from armctl.agents.costs import TuningCost
from armctl.core.errors import ConfigurationError, ResultsError
from armctl.core.files import sealed, unsealed
from armctl.core.search_space import value_at
from armctl.simulation.threads import THREADS_ENV_VAR
from armctl.study import compare
from armctl.training.learners import load_recipe
from armctl.training.trials import read_trials
from armctl.tuning import candidate_of, tunable, tune
from armctl.tuning.candidates import BLOCK, Pruned, RecipeCandidate
from armctl.tuning.journal import JOURNAL, TUNING
from armctl.tuning.trials import measure

from .small_tunings import RECIPE, expert

CRASHING = RECIPE.replace("low = 1e-4, high = 1e-2", "low = 1e-4, high = 1e300")


def test_the_first_trial_is_the_present_values(tmp_path):
    found = tune(expert(), tmp_path, trials=2)
    assert found.trials[0].params == found.candidate.present
    assert found.present_trial is found.trials[0]
    assert len(found.trials) == 2
    assert found.processor_seconds > 0


@pytest.mark.slow
def test_more_trials_resume_and_the_same_number_does_nothing(tmp_path):
    first, again, more = (
        [one.params for one in tune(expert(), tmp_path, trials=trials).trials] for trials in (2, 2, 4)
    )
    assert first == again == more[:2]
    assert len(more) == 4
    rows = read_trials(tmp_path / "trials.csv")
    assert [row["ended"] for row in rows] == ["finished"] * 4
    assert not list((tmp_path / "processes").iterdir())


@pytest.mark.slow
def test_the_same_seed_proposes_the_same_values(tmp_path):
    found = [tune(expert(), tmp_path / str(i), trials=3, seed=seed) for i, seed in enumerate((3, 3, 4))]
    proposed = [[one.params for one in one.trials] for one in found]
    assert proposed[0] == proposed[1] != proposed[2]


def test_an_hour_of_nothing_is_no_budget(tmp_path):
    found = tune(expert(), tmp_path, hours=1e-9)
    assert len(found.trials) == 1
    for wrong in ({}, {"trials": 0}, {"hours": -1.0}, {"hours": float("nan")}):
        with pytest.raises(ConfigurationError, match=r"budget|more than 0"):
            tune(expert(), tmp_path / "other", **wrong)


@pytest.mark.slow
def test_a_recipe_is_judged_by_the_median_of_its_trainings(recipe, tmp_path):
    candidate = candidate_of(recipe, training_seeds=3)
    found = tune(candidate, tmp_path / "out", trials=1)
    for one in found.trials:
        curves = [
            pd.read_csv(file)
            for file in sorted((tmp_path / "out" / "trials" / f"{one.number:04d}").glob("*/curve.csv"))
        ]
        best = [curve.sort_values(["success", "return"])["return"].iloc[-1] for curve in curves]
        assert one.value == pytest.approx(sorted(best)[1])
        assert one.user_attrs["scores"] == pytest.approx(best)
    seeds = {json.loads(file.read_text())["training_seed"] for file in tmp_path.glob("out/trials/0000/*/agent.json")}
    assert seeds.isdisjoint(load_recipe("reach_sac").seeds)


@pytest.mark.slow
def test_the_best_values_are_a_recipe(recipe, tmp_path):
    found = tune(candidate_of(recipe, training_seeds=1), tmp_path / "out", trials=5)
    best = found.best
    assert best.value == max(one.value for one in found.finished)
    assert best is not found.present_trial, (
        "no trial was better than the present values: choose another seed for this test"
    )
    tuned = load_recipe(found.best_file)
    assert tuned.name == "small_tuned"
    assert {path: value_at(tuned.model_dump(), path) for path in best.params} == best.params
    assert tuned.tuned == TuningCost(len(found.trials), round(found.processor_seconds / 60, 1))
    assert tuned.changed(options=load_recipe(recipe).options, name="small", tuned=None) == load_recipe(recipe)


@pytest.mark.slow
def test_the_best_options_of_an_expert_can_be_compared(tmp_path):
    found = tune(expert(), tmp_path, trials=8)
    assert found.best is not found.present_trial, "no trial was better: choose another seed for this test"
    values = tomllib.loads(found.best_file.read_text())
    assert {path: value_at(values, path) for path in found.best.params} == found.best.params
    result = compare([str(found.best_file)], "armctl/ArmReach-v0", episodes=2)
    assert not result.failures


@pytest.mark.slow
def test_workers_measure_as_this_process_does(tmp_path):
    candidate = expert()
    found = tune(candidate, tmp_path, trials=3, workers=2)
    for one in found.finished:
        here = measure(candidate, 0, one.params, tmp_path, [])
        assert here.value == one.value


@pytest.mark.slow
def test_a_hopeless_trial_is_pruned(tmp_path):
    candidate = expert(episodes=3 * BLOCK)
    ended = tune(expert(episodes=3), tmp_path / "few", trials=1).study.trials[0]
    others = []
    for number in range(6):
        good = type(ended)(
            number=number, state=TrialState.COMPLETE, value=1e6, datetime_start=ended.datetime_start,
            datetime_complete=ended.datetime_complete, params=ended.params, distributions=ended.distributions,
            user_attrs={}, system_attrs={}, intermediate_values={0: 1e6, 1: 1e6, 2: 1e6}, trial_id=number,
        )  # fmt: skip
        others.append(good)
    pruned, kept = (measure(candidate, 9, candidate.present, tmp_path, past) for past in (others, []))
    assert pruned.pruned
    assert len(pruned.reports) == 2
    assert not kept.pruned
    assert len(kept.reports) == 3
    assert pruned.processor_seconds < kept.processor_seconds


@pytest.mark.slow
def test_a_training_is_interrupted_where_it_is_pruned(recipe, tmp_path):
    candidate, told = candidate_of(recipe, training_seeds=1), []
    assert isinstance(candidate, RecipeCandidate)

    def report(step, score):
        told.append(step)
        raise Pruned

    slow = candidate.recipe.changed(options=candidate.recipe.options | {"steps": 20_000})
    slower = dataclasses.replace(candidate, recipe=slow)
    with pytest.raises(Pruned):
        slower.measure(candidate.present, tmp_path / "run", report)
    assert told == [0]
    assert not list(tmp_path.glob("run/*/agent.json"))


@pytest.mark.slow
def test_values_that_fail_are_noted_and_three_in_a_row_end_it(tmp_path):
    file = tmp_path / "crashing.toml"
    file.write_text(CRASHING)
    with pytest.raises(ConfigurationError, match="3 trials in a row failed"):
        tune(candidate_of(str(file), training_seeds=1), tmp_path / "out", trials=30, seed=1)
    rows = read_trials(tmp_path / "out" / "trials.csv")
    assert [row["ended"] for row in rows[-3:]] == ["failed"] * 3
    assert rows[0]["ended"] == "finished"


def test_present_values_that_fail_end_it_at_once(recipe, tmp_path):
    candidate = candidate_of(recipe, training_seeds=1)
    assert isinstance(candidate, RecipeCandidate)
    broken = candidate.recipe.changed(options=candidate.recipe.options | {"demonstrations": 0})
    with pytest.raises(ConfigurationError, match=r"fails with its present values.*demonstrations"):
        tune(dataclasses.replace(candidate, recipe=broken), tmp_path / "out", trials=3)


def _tune_until_killed(folder, episodes):
    tune(expert(episodes=episodes), folder, trials=50, progress=lambda found: None)


@pytest.mark.slow
def test_after_kill_9_a_lost_trial_is_tried_again(tmp_path):
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=_tune_until_killed, args=(tmp_path, 6))
    process.start()
    while not (tmp_path / "trials.csv").exists() or len(read_trials(tmp_path / "trials.csv")) < 2:
        assert process.is_alive()
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    with (tmp_path / JOURNAL).open("ab") as journal:  # it may die in the middle of a line
        journal.write(b'{"op_code": 4, "worker_')
    before = len(read_trials(tmp_path / "trials.csv"))
    found = tune(expert(episodes=6), tmp_path, trials=before + 2)
    assert len(found.trials) == before + 2
    states = [one.state for one in found.study.trials]
    lost = [one for one in found.study.trials if one.state is TrialState.FAIL]
    assert states.count(TrialState.RUNNING) == 0
    for one in lost:
        values = one.params.items()  # some of them, if it died while they were proposed
        assert any(values <= other.params.items() for other in found.trials)


@pytest.mark.slow
def test_two_processes_share_a_study(tmp_path):
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=_tune_some, args=(tmp_path, seed)) for seed in (1, 2)]
    for one in processes:
        one.start()
    for one in processes:
        one.join()
        assert one.exitcode == 0
    found = tune(expert(), tmp_path, trials=6)
    assert 6 <= len(found.trials) <= 7  # each may have asked for the last one
    assert len({one.number for one in found.trials}) == len(found.trials) == len(read_trials(tmp_path / "trials.csv"))


def _tune_some(folder, seed):
    tune(expert(), folder, trials=6, seed=seed)


def test_trials_by_other_code_are_not_mixed_with_it(begun, monkeypatch):
    monkeypatch.setattr(type(expert()), "code", {"reach_mpc.py": "another"})
    with pytest.raises(ResultsError, match=r"code: reach_mpc.py .* there, another here"):
        tune(expert(), begun, trials=2)


@pytest.mark.parametrize("change", ["episodes", "score", "options"])
def test_another_tuning_is_not_mixed_with_it(begun, change):
    other = {"episodes": expert(episodes=4), "score": expert(score="success")}
    if change == "options":
        configuration = expert().configuration.model_copy(update={"env_options": {"tolerance": 0.02}})
        other["options"] = dataclasses.replace(expert(), configuration=configuration)
    with pytest.raises(ResultsError, match="holds another tuning"):
        tune(other[change], begun, trials=2)


def test_a_tuning_of_another_format_is_refused(begun):
    file = begun / TUNING
    file.write_text(sealed({**unsealed(file.read_text(), 1), "format": 2}))
    with pytest.raises(ResultsError, match=r"tuning\.json .* format 2; armctl .* reads format 1"):
        tune(expert(), begun, trials=2)


@pytest.mark.parametrize("damage", [b"what\n", b'{"op_code": 99}\n', b"\x00\n"])
def test_a_damaged_journal_is_told(begun, damage):
    journal = begun / JOURNAL
    journal.write_bytes(damage + journal.read_bytes())
    with pytest.raises(ResultsError, match=r"journal.log is damaged"):
        tune(expert(), begun, trials=2)


def test_nothing_is_written_through_a_link(tmp_path):
    (tmp_path / "elsewhere").write_text("")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / JOURNAL).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(ResultsError):
        tune(expert(), tmp_path / "out", trials=1)
    assert (tmp_path / "elsewhere").read_text() == ""


@pytest.mark.slow
def test_this_process_may_use_its_threads_again(recipe, tmp_path, monkeypatch):
    monkeypatch.delenv(THREADS_ENV_VAR, raising=False)
    tune(candidate_of(recipe, training_seeds=1), tmp_path, trials=1)
    assert THREADS_ENV_VAR not in os.environ


def test_a_folder_that_cannot_be_made_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ResultsError, match="cannot be written to"):
        tune(expert(), tmp_path / "file" / "out", trials=1)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("reach_mcp", {}, "Did you mean 'reach_mpc'"),
        ("reach_bc", {}, "no search space"),
        ("random", {}, "There are: .*reach_mpc"),
        ("nowhere.toml", {}, "cannot be read"),
        ("reach_mpc", {"score": "sucess"}, "Did you mean 'success'"),
        ("reach_mpc", {"episodes": 0}, "at least one of its episodes"),
        ("reach_sac", {"training_seeds": 0}, "at least one of its training seeds"),
    ],
)
def test_what_cannot_be_tuned_is_told(name, options, message):
    with pytest.raises(ConfigurationError, match=message):
        candidate_of(name, **options)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[tune]\nlearner = { choices = ['bc', 'sac'] }", "no key of .tune. in .*'learner'"),
        ("[tune.seeds]\nx = { low = 1, high = 2 }", "no key of .tune."),
        ("[tune.options]\ngamma = { low = 0.9, high = 0.99 }", "does not say which value options.gamma has now"),
    ],
)
def test_a_recipe_whose_space_is_wrong_is_refused(tmp_path, text, message):
    file = tmp_path / "it.toml"
    file.write_text(RECIPE.partition("[tune")[0] + text)
    with pytest.raises(ConfigurationError, match=message):
        candidate_of(str(file))


@pytest.mark.parametrize("name", tunable())
def test_each_shipped_search_space_has_its_present_values(name):
    candidate = candidate_of(name)
    assert all(candidate.present[path] in one for path, one in candidate.space.items())
    assert Path(name).suffix == ""

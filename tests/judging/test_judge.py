"""What is known decides what is said: pairs or not, cells, trainings, and nothing about what nobody measured."""

import json
import random
from typing import Any

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest
import scipy.stats

import armctl as package
from armctl.core.errors import ConfigurationError, ResultsError
from armctl.episodes.stored import STORE
from armctl.judging import judge

from ..command_line import armctl
from .written import WINS, evaluations, judged, rows_of, table

NEVER_SAID = (
    "simulator",
    "state",
    "untrained",
    "ms",
    "least time",
    "as one network",
    "trained for",
    "seed 0",
    "[*]",
    "control step",
)


def text_of(judgement):
    document = judgement.document()
    tables = " ".join(f"{part.title} {part.caption} {part.rows}" for part in document.tables)
    return " ".join([tables, *(part.text for part in document.parts if part not in document.tables)])


def test_nothing_is_said_of_what_is_unknown(tmp_path):
    judgement = judged(tmp_path, rows_of(WINS))
    text = text_of(judgement)
    assert "not declared" in text
    assert "unknown" in text
    assert [word for word in NEVER_SAID if word in text.split(" decision ms ")[0]] == []
    assert judgement.overall.verdict.cost == ""
    assert [column.heading for column in judgement.document().tables[0].columns] == [
        "policy", "success", "decision ms", "sees",
    ]  # fmt: skip
    assert not any(name in str(judgement.overall.verdict) for name in ("decision time", "privilege", "training"))


def test_what_is_known_is_said(tmp_path):
    lines = [
        f"{line},{k % 90 + 10},{2.5 if 'new' in line else 5}" if k else f"{line},steps,latency_ms"
        for k, line in enumerate(rows_of(WINS))
    ]
    judgement = judged(tmp_path, lines, learned=("new",), max_steps=100)
    new, old = judgement.overall.policies
    assert (new.side, old.side) == ("learned", "classical")
    assert judgement.overall.verdict.cost == "Median decision time: new 2.5 ms, old 5 ms."
    assert "The result holds for new as one network." in judgement.overall.verdict.context
    assert new.restricted_steps.low is not None
    with pytest.raises(ConfigurationError, match="an episode has 90 steps, more than"):
        judged(tmp_path, lines, max_steps=89)


def test_equal_episodes_are_pairs_and_surplus_ones_are_left_out(tmp_path):
    lines = rows_of(WINS)
    both = judged(tmp_path, lines).overall
    assert both.differences[0].success_p == scipy.stats.binomtest(0, 14).pvalue
    surplus = judged(tmp_path, [*lines, "new,40,no", "new,41,no"])
    assert str(surplus.overall.differences) == str(both.differences)
    said = "2 of new (0 of them and 36 of the 40 kept are successes)"
    assert f"Episodes that not all policies have are left out: {said}." in surplus.overall.notes


def test_others_are_no_pairs(tmp_path):
    lines = [line for line in rows_of(WINS) if not line.startswith("new,39")]
    assert judged(tmp_path, [*lines, "old,100,yes"]).overall.facts.paired
    assert not judged(tmp_path, [*lines, "old,100,yes", "new,101,no"]).overall.facts.paired


def test_samples_that_are_no_pairs_have_the_unpaired_test(tmp_path):
    judgement = judged(tmp_path, rows_of(WINS), unpaired=True)
    difference = judgement.overall.differences[0]
    assert not difference.paired
    barnard = scipy.stats.barnard_exact([[36, 22], [4, 18]], pooled=True).pvalue
    assert difference.success_p == pytest.approx(barnard, rel=0.35)
    assert "on the same episodes" not in text_of(judgement)
    assert "McNemar" not in text_of(judgement)


def test_policies_may_have_different_numbers_of_episodes(tmp_path):
    lines = ["policy,success", *["a,yes"] * 30, *["a,no"] * 5, *["b,yes"] * 20, *["b,no"] * 30]
    judgement = judged(tmp_path, lines)
    assert [policy.episodes for policy in judgement.overall.policies] == [35, 50]
    assert judgement.conclusions[0].outcome == "better"
    assert "cut short" not in text_of(judgement)


@pytest.mark.slow
@hypothesis.settings(max_examples=6)
@hypothesis.given(seed=st.integers(0, 10**6), keys=st.sampled_from(["", "episode", "seed", "task", "training_seed"]))
def test_the_order_of_rows_changes_nothing(tmp_path_factory, seed, keys):
    rng, folder = random.Random(seed), tmp_path_factory.mktemp("shuffled")
    columns = ",".join(filter(None, ("policy", keys, "success", "return")))
    groups = {"task": 3, "training_seed": 2}
    lines = []
    for policy in ("b", "a"):
        for k in range(12):
            key = [] if not keys else [str(k % groups[keys])] if keys in groups else [str(k)]
            success = rng.choice(["yes", "no"])
            lines.append(",".join([policy, *key, success, f"{rng.gauss(0, 1):.3f}"]))
    told = []
    for _ in range(2):
        told.append(judged(folder, [columns, *lines], return_bounds=(-10.0, 10.0)).document())
        rng.shuffle(lines)
    assert str(told[0]) == str(told[1])


def tasks_of(tmp_path, gain, episodes=25, tasks=4, **terms):
    """Two policies in some tasks, of which the new one wins `gain[i]` more episodes in the i-th."""
    lines = ["policy,task,episode,success"]
    for i in range(tasks):
        lines += [f"old,pick {i},{k},{int(k < 8)}" for k in range(episodes)]
        lines += [f"new,pick {i},{k},{int(k < 8 + gain[i])}" for k in range(episodes)]
    return judged(tmp_path, lines, baseline="old", **terms)


def test_a_task_is_a_cell_and_all_together_have_a_verdict(tmp_path):
    judgement = tasks_of(tmp_path, [12, 0, 12, -8])
    assert [*judgement.cells] == ["pick 0", "pick 1", "pick 2", "pick 3"]
    assert judgement.overall.policies[0].episodes == 100
    assert [judgement.by_cell[name][0].outcome for name in judgement.cells] == [
        "better",
        "undecided",
        "better",
        "worse",
    ]
    assert judgement.conclusions[0].outcome == "better"
    assert judgement.fails({"worse"})  # in one task
    assert not judgement.fails({"undecided"})
    assert "new is worse than old" in str(judgement.document().tables[-1].rows)


def test_the_verdict_on_each_task_is_corrected_for_their_number(tmp_path):
    alone = judged(tmp_path, ["policy,episode,success", *(f"{name},{k},{int(k < won)}" for k in range(25)
                                                          for name, won in (("old", 8), ("new", 14)))])  # fmt: skip
    assert alone.conclusions[0].outcome == "better"
    assert tasks_of(tmp_path, [6, 0, 0, 0]).by_cell["pick 0"][0].outcome == "undecided"


def test_tasks_with_other_numbers_of_episodes_are_not_pooled(tmp_path):
    lines = ["policy,task,success", *["a,x,yes"] * 20, *["b,x,no"] * 20, *["a,y,yes"] * 20, *["b,y,yes"] * 40]
    judgement = judged(tmp_path, lines)
    assert judgement.overall is None
    assert (
        judgement.document().parts[0].text.startswith("No verdict on all together, as the numbers of episodes differ")
    )
    assert [one.outcome for one in judgement.conclusions] == ["better", "undecided"]


def test_conditions_are_cells_too(tmp_path):
    lines = ["policy,condition,trial,success"]
    lines += [f"{name},{light},{k},{int(k < won)}" for name in ("a", "b") for light, won in (("dim", 3), ("bright", 9))
              for k in range(12)]  # fmt: skip
    assert [*judged(tmp_path, lines).cells] == ["bright", "dim"]


def test_trainings_are_one_learner(tmp_path):
    rng = np.random.default_rng(0)
    lines = ["policy,train_seed,episode,success"]
    lines += [f"{name},{seed},{k},{int(rng.random() < share)}" for name, share in (("ppo", 0.9), ("bc", 0.2))
              for seed in range(8) for k in range(30)]  # fmt: skip
    judgement = judged(tmp_path, lines)
    assert judgement.overall.names == ["bc[*]", "ppo[*]"]
    assert judgement.overall.policies[0].trainings.keys() == {f"bc[{seed}]" for seed in range(8)}
    assert judgement.conclusions[0].outcome == "better"
    assert judged(tmp_path, lines, baseline="bc").conclusions[0].against == "bc[*]"
    without_numbers = [lines[0].replace("episode", "remark"), *lines[2:]]
    with pytest.raises(ConfigurationError, match="the trainings of ppo have 29, 30 episodes"):
        judged(tmp_path, without_numbers)


def test_times_are_judged_with_a_time_limit(tmp_path):
    lines = ["policy,trial,success,time"]
    lines += [
        f"{name},{k},{'no' if k == 3 else 'yes'},{seconds + k % 3}"
        for name, seconds in (("fast", 5), ("slow", 20))
        for k in range(40)
    ]
    told = judged(tmp_path, lines)
    times = "Mean time of successes: fast 6 s, slow 21 s; it is not tested."
    assert times in told.overall.notes
    assert "return" in told.overall.facts.unknown
    limited = judged(tmp_path, lines, time_limit=60.0)
    assert limited.overall.facts.return_bounds == (-60.0, 0.0)
    assert "fast earns" in str(limited.overall.verdict)
    assert limited.overall.results.column("total_reward").min() == -60
    with pytest.raises(ConfigurationError, match="the time 21 s is beyond the limit, 20 s"):
        judged(tmp_path, lines, time_limit=20.0)
    only = [f"{cells[0]},{cells[3]}" for cells in (line.split(",") for line in lines)]
    assert judged(tmp_path, only).conclusions[0].policy == "fast"


def test_success_may_be_a_return(tmp_path):
    lines = [line.replace("success", "return").replace("yes", "9").replace("no", "1") for line in rows_of(WINS)]
    judgement = judged(tmp_path, lines, success_return=5.0)
    assert judgement.overall.differences[0].success_difference.value == pytest.approx(0.35)
    with pytest.raises(ConfigurationError, match="outside 2 to 9"):
        judged(tmp_path, lines, return_bounds=(2.0, 9.0))


def test_wrong_words_are_told(tmp_path):
    with pytest.raises(ConfigurationError, match=r"no policy in these results 'nwe'\. Did you mean 'new'"):
        judged(tmp_path, rows_of(WINS), baseline="nwe")
    with pytest.raises(ConfigurationError, match="has no column 'agnt' for the policy"):
        judged(tmp_path, rows_of(WINS), columns={"policy": "agnt"})
    with pytest.raises(ConfigurationError, match="no field of a trial 'polcy'"):
        judged(tmp_path, rows_of(WINS), columns={"polcy": "policy"})
    with pytest.raises(ConfigurationError, match="no option 'basline'"):
        package.judge(tmp_path, basline="new")


def test_terms_that_a_folder_of_armctl_has_no_use_for_are_refused(tmp_path):
    (tmp_path / STORE).write_bytes(b"")
    useless: dict[str, Any] = {
        "learned": ["a"], "success_return": 1.0, "return_bounds": (0.0, 1.0), "time_limit": 3.0, "max_steps": 5,
        "any_number": True, "unpaired": True, "policies_in_columns": True, "task": "x",
    }  # fmt: skip
    for name, value in useless.items():
        with pytest.raises(ConfigurationError, match=f"has armctl's own results, .* no --{name.replace('_', '-')}$"):
            judge(tmp_path, **{name: value})
    with pytest.raises(ConfigurationError, match=r"no --max-steps, no --any-number$"):
        judge(tmp_path, max_steps=5, any_number=True)
    with pytest.raises(ResultsError):  # by whoever reads it
        judge(tmp_path, margin=0.1, learned=())


@pytest.mark.parametrize(
    ("baseline", "fail_if", "status"),
    [("old", "worse", 0), ("new", "worse", 1), ("old", "better", 1), ("old", "undecided", 0)],
)
def test_the_exit_status_follows_the_verdict(tmp_path, baseline, fail_if, status):
    table(tmp_path, rows_of(WINS))
    arguments = ("trials.csv", "--baseline", baseline, "--fail-if", fail_if, "--badge")
    done = armctl("judge", *arguments, cwd=tmp_path, check=False)
    assert done.returncode == status
    mark, better = ("🟢", "better") if baseline == "old" else ("🔴", "worse")
    assert done.stdout.startswith(f"{mark} **")
    assert f": {better}, " in done.stdout
    assert done.stdout.count("\n") == 1


def test_an_exit_status_needs_a_baseline(tmp_path):
    table(tmp_path, rows_of(WINS))
    done = armctl("judge", "trials.csv", "--fail-if", "worse", cwd=tmp_path, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert "--fail-if needs a --baseline" in done.stderr


def test_columns_are_named_on_the_command_line(tmp_path):
    table(tmp_path, rows_of(WINS, columns="who,which,how"))
    named = ("--policy-column", "who", "--episode-column", "which", "--success-column", "how")
    printed = armctl("judge", "trials.csv", *named, "--format", "json", cwd=tmp_path).stdout
    assert json.loads(printed)["verdict"].startswith("new is better than old: success +35.0 points")


@pytest.mark.slow
def test_a_folder_gets_the_report_and_the_tables(tmp_path):
    table(tmp_path, rows_of(WINS))
    armctl("judge", "trials.csv", "--out", "out", cwd=tmp_path)
    page = (tmp_path / "out" / "report.html").read_text()
    body = page.partition("<main>")[2].partition("<script>")[0]
    assert "new is better than old" in body
    assert "trials.csv" in body
    for missing in ("Reproduce", "Decision times", "Performance profile", "armctl compare", "seed 0", "nan"):
        assert missing not in body, missing
    for unknown in ("return", "clean", "steps", "efficiency", "decision"):
        assert f"<th>{unknown}" not in body, unknown
    assert (tmp_path / "out" / "verdict.md").read_text().startswith("🟢 **new 90.0 % against old 55.0 %")
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["sources"] == ["trials.csv"]
    again = armctl("judge", "trials.csv", "--out", "out", cwd=tmp_path, check=False)
    assert again.returncode == 2
    assert "holds results already" in again.stderr
    armctl("judge", "trials.csv", "--out", "out", "--overwrite", cwd=tmp_path)


@pytest.mark.slow
def test_each_task_has_a_report_of_its_own(tmp_path):
    from armctl.report.judgement import write_judgement

    judgement = tasks_of(tmp_path, [12, 0, 12, -8])
    write_judgement(judgement, tmp_path / "out")
    assert sorted(path.parent.name for path in (tmp_path / "out").glob("*/report.html")) == [
        f"pick_{i}" for i in range(4)
    ]
    assert "pick 3" in (tmp_path / "out" / "verdict.md").read_text()


def test_returns_without_bounds_are_judged_by_the_higher_one(tmp_path):
    files = [evaluations(tmp_path / name / "evaluations.npz", mean) for name, mean in (("a", 0.0), ("b", 9.0))]
    judgement = judge(files)
    assert judgement.conclusions[0].policy == "b"
    assert "possible returns are unknown" in text_of(judgement)


def test_names_write_nothing_to_the_terminal_but_themselves(tmp_path):
    lines = [line.replace("new", "n\x1b[2Jw*_<b>") for line in rows_of(WINS)]
    table(tmp_path, lines)
    for arguments in ((), ("--badge",), ("--format", "markdown"), ("--format", "csv")):
        printed = armctl("judge", "trials.csv", *arguments, cwd=tmp_path).stdout
        assert "\x1b" not in printed
        assert "\\x1b[2Jw" in printed.replace("\\[", "[").replace("\\\\", "\\")
    assert "w\\*\\_\\<b\\>" in armctl("judge", "trials.csv", "--badge", cwd=tmp_path).stdout


def test_a_suite_answers_for_classical_and_learned_policies(tmp_path):
    judgement = tasks_of(tmp_path, [12, 0, 12, -8], learned=("new",))
    headline = judgement.study[0].text
    assert headline.startswith("Of 4 tasks, by success: ")
    assert "learned is better in pick 0 and pick 2" in headline
    assert "classical is better in pick 3" in headline
    assert "seed 0" not in text_of(judgement)
    assert "decision time" not in " ".join(part.text for part in judgement.study if hasattr(part, "text"))
    assert list(tasks_of(tmp_path, [12, 0, 12, -8]).study) == []


@pytest.mark.parametrize(
    ("conditions", "swept"),
    [
        (("none", "payload-1.0", "payload-2"), True),
        (("Nominal", "delay 40 ms", "delay 80 ms"), True),
        (("payload-1.0", "payload-2"), False),
        (("none", "dim light"), False),
        (("none", "payload-1", "payload-1.0"), False),
    ],
)
def test_conditions_are_a_sweep_only_with_levels_and_an_undisturbed_one(tmp_path, conditions, swept):
    lines = ["policy,condition,episode,success"]
    lines += [f"{name},{condition},{k},{int(k < won - 3 * i)}" for i, condition in enumerate(conditions)
              for name, won in (("a", 18), ("b", 12)) for k in range(20)]  # fmt: skip
    assert bool(judged(tmp_path, lines).study) == swept

"""Trials logged by hand: in a drawn order, each kept at once."""

import io
import itertools
import json
import sys
from collections import Counter

import pytest

from armctl.core.errors import ConfigurationError, ResultsError
from armctl.judging import judge
from armctl.judging.log import TrialLog, entry_of

from ..command_line import armctl


@pytest.fixture
def typed(monkeypatch, tmp_path):
    """Run `armctl log` with lines that somebody types."""

    def run(*arguments, lines=(), check=True):
        monkeypatch.setattr(sys, "stdin", io.StringIO("".join(f"{line}\n" for line in lines)))
        return armctl("log", "arm.csv", *arguments, cwd=tmp_path, check=check)

    return run


def test_a_session(typed, tmp_path):
    done = typed("act", "pi0", "--episodes", "6", "--seed", "1", lines=["y 12.5 slow", "n", "hm", "u", "y 3,5", "q"])
    assert "'hm' is neither y nor n" in done.stdout
    assert "taken back: 2, 1," in done.stdout
    assert "2 of 12 trials are in arm.csv: the same command goes on" in done.stdout
    rest = typed(lines=["n 30 dropped it, twice", *["y"] * 12])
    assert "trial 3/12, initial condition 2" in rest.stdout
    assert "12 of 12 trials are in arm.csv: armctl judge arm.csv gives the verdict." in rest.stdout
    log = TrialLog.read(tmp_path / "arm.csv")
    assert [row[3:] for row in log.rows[:3]] == [
        ["yes", "12.5", "slow"], ["yes", "3.5", ""], ["no", "30", "dropped it, twice"],
    ]  # fmt: skip
    comparison = judge(tmp_path / "arm.csv").overall
    assert comparison.facts.paired
    assert [policy.episodes for policy in comparison.policies] == [6, 6]


def test_a_log_stands_beside_a_simulated_task_by_the_name_of_its_own(typed, tmp_path):
    typed("act", "pi0", "--episodes", "6", "--task", "bench", lines=["y"] * 12)
    rows = [f"{policy},{k},yes,reach" for policy in ("act", "pi0") for k in range(6)]
    (tmp_path / "simulated.csv").write_text("\n".join(["policy,episode,success,task", *rows]))
    assert sorted(judge([tmp_path / "arm.csv", tmp_path / "simulated.csv"]).cells) == ["bench", "reach"]
    assert "a log of other task, bench" in typed("--task", "table", check=False).stderr.replace("\n", " ")


def test_each_initial_condition_is_tried_with_all_policies_in_a_drawn_order(tmp_path):
    log = TrialLog.begin(tmp_path / "arm.csv", ["a", "b", "c"], 300, 7, False)
    by_condition = [
        [policy for _, policy in trials] for _, trials in itertools.groupby(log.schedule, lambda trial: trial[0])
    ]
    assert all(sorted(order) == ["a", "b", "c"] for order in by_condition)
    orders = Counter(map(tuple, by_condition))
    assert len(orders) == 6
    assert min(orders.values()) > 30
    assert TrialLog.begin(tmp_path / "other.csv", ["a", "b", "c"], 300, 8, False).schedule != log.schedule


def test_policies_are_letters_until_the_end(typed, tmp_path):
    shown = typed("act", "pi0", "--episodes", "2", "--seed", "3", "--blind", "--key", "key.json", lines=["y", "n", "y"])
    _, *rows = (tmp_path / "arm.csv").read_text().splitlines()
    assert "policy A" in shown.stdout
    assert "act" not in shown.stdout.replace("armctl", "")
    assert {row.split(",")[2] for row in rows[1:]} <= {"A", "B"}
    with pytest.raises(ConfigurationError, match="is blinded, and has 3 of 4 trials: finish it first"):
        judge(tmp_path / "arm.csv")
    key = json.loads((tmp_path / "key.json").read_text())
    letters = [row.split(",")[2] for row in rows[1:]]
    end = typed(lines=["n", ""])
    assert "Unblinded: A is " in end.stdout
    names = [row[2] for row in TrialLog.read(tmp_path / "arm.csv").rows]
    assert names[:3] == [key[letter] for letter in letters]
    assert {policy.policy for policy in judge(tmp_path / "arm.csv").overall.policies} == {"act", "pi0"}


def test_a_blinded_log_can_be_ended_early(typed, tmp_path):
    typed("a", "b", "--blind", "--seed", "1", lines=["y", "n", "n"])
    assert "Unblinded" in typed("--unblind").stdout
    judgement = judge(tmp_path / "arm.csv")
    assert judgement.overall.differences[0].any_number


@pytest.mark.parametrize("kept", [True, False])
def test_a_finished_log_remembers_that_it_may_have_been_judged_before(typed, tmp_path, kept):
    """Also without the comment that says what it is."""
    typed("a", "b", "--episodes", "12", "--seed", "1", lines=["y", "n"] * 12)
    lines = (tmp_path / "arm.csv").read_text().splitlines(keepends=True)
    (tmp_path / "arm.csv").write_text("".join(lines[0 if kept else 1 :]))
    assert judge(tmp_path / "arm.csv").overall.differences[0].any_number
    with pytest.raises(ConfigurationError, match="as a log has, needs pairs"):
        judge(tmp_path / "arm.csv", unpaired=True)


def test_the_last_trial_can_be_taken_back_too(typed, tmp_path):
    typed("a", "b", "--episodes", "1", "--seed", "1", lines=["y", "y", "u", "n", ""])
    assert [row[3] for row in TrialLog.read(tmp_path / "arm.csv").rows] == ["yes", "no"]
    assert "nothing to take back" in typed(lines=["u", "u", "u"]).stdout


@pytest.mark.slow
def test_a_trial_that_was_cut_off_is_asked_again(typed, tmp_path):
    typed("a", "b", "--episodes", "2", "--seed", "1", lines=["y", "n"])
    whole = (tmp_path / "arm.csv").read_text()
    for end in range(len(whole.rstrip().rpartition("\n")[0]) + 2, len(whole)):
        (tmp_path / "arm.csv").write_text(whole[:end])
        typed(lines=["n"])
        assert (tmp_path / "arm.csv").read_text() == whole


@pytest.mark.one_case
@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace('"armctl_log": 1', '"armctl_log": 2'),
        lambda text: text.replace('"seed": 1', '"seed": 99'),
        lambda text: text.replace("1,1,", "1,2,", 1),
        lambda text: text.replace("yes", "maybe"),
        lambda text: text.replace("trial,", "Trial,"),
        lambda text: "policy,success\na,yes\n",
        lambda text: "",
        lambda text: text + "\n".join(f"{i},{i},a,yes,," for i in range(3, 9)) + "\n",
    ],
)
def test_a_log_that_was_changed_is_not_continued(typed, tmp_path, change):
    typed("a", "b", "--episodes", "2", "--seed", "1", lines=["y", "n"])
    changed = change((tmp_path / "arm.csv").read_text())
    (tmp_path / "arm.csv").write_text(changed)
    done = typed(lines=["y"], check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert "is no log of armctl's, or was changed" in done.stderr
    assert (tmp_path / "arm.csv").read_text() == changed


def test_another_plan_is_refused(typed, tmp_path):
    assert "there is no log arm.csv: name the policies" in typed(check=False).stderr
    typed("a", "b", "--seed", "1")
    for arguments in (["a", "c"], ["--episodes", "3"], ["--seed", "2"]):
        assert "is a log of other" in typed(*arguments, check=False).stderr
    with pytest.raises(ResultsError, match="is a log of other policies"):
        TrialLog.read(tmp_path / "arm.csv").check_plan(["a"], None, None)


@pytest.mark.parametrize("names", [["a"], ["a", "A"], ["a", " "], list("abcdefghijklmnopqrstuvwxyzä")])
def test_a_log_needs_policies_that_differ(tmp_path, names):
    with pytest.raises(ConfigurationError, match="a log needs"):
        TrialLog.begin(tmp_path / "arm.csv", names, 3, 0, False)
    assert not (tmp_path / "arm.csv").exists()


@pytest.mark.parametrize(
    ("line", "entry"),
    [
        ("y", (True, None, "")),
        (" N ", (False, None, "")),
        ("yes 12.5", (True, 12.5, "")),
        ("no 12,5s too slow", (False, 12.5, "too slow")),
        ("y 12.5 slow", (True, 12.5, "slow")),
        ("y 80 sec, slow", (True, 80.0, "slow")),
        ("n 80 s", (False, 80.0, "")),
        ("n - 3 collisions", (False, None, "- 3 collisions")),
        ("1 it fell at 3", (True, None, "it fell at 3")),
        ("y - no time", (True, None, "- no time")),
    ],
)
def test_a_trial_is_a_line(line, entry):
    assert entry_of(line) == entry


@pytest.mark.parametrize("line", ["", "maybe", "0.5", "12", "y -3", "y 2 min", "y 2min", "y 1 min 20",
                                  "y 1:20", "n 3 collisions", "y 40 steps", "y 500ms", "y 1e5", "n 80 %", "y 1,2,3",
                                  "y 2 Minutes"])  # fmt: skip
def test_a_line_that_is_none_is_asked_again(line):
    with pytest.raises(ConfigurationError):
        entry_of(line)


@pytest.mark.slow
def test_a_pipe_is_as_good_as_a_terminal_and_a_full_disk_loses_nothing(tmp_path):
    import subprocess

    from ..command_line import ARMCTL, full_disk

    begin = [ARMCTL, "log", "arm.csv", "a", "b", "--seed", "1"]
    done = subprocess.run(begin, input="y\nn\n", text=True, capture_output=True, cwd=tmp_path, check=True)
    assert "2 of 40 trials" in done.stdout
    before = (tmp_path / "arm.csv").read_text()
    log = TrialLog.read(tmp_path / "arm.csv")
    with full_disk(len(before)), pytest.raises(ResultsError, match="cannot be written"):
        log.add(True, None, "")
    assert TrialLog.read(tmp_path / "arm.csv").rows == log.rows
    assert armctl("judge", "arm.csv", cwd=tmp_path).stdout.startswith("No verdict from 1 episode")

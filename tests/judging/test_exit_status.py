"""An exit status that tells nothing was worse needs that something was compared."""

import pytest

from armctl.core.errors import ConfigurationError
from armctl.report.judgement import badge

from ..command_line import armctl
from .written import judged, table


def cells_of(members, episodes=20):
    """Rows of a CSV file: who won how many episodes of which task."""
    return ["policy,task,episode,success", *(f"{policy},{task},{k},{int(k < won)}" for policy, task, won in members
                                             for k in range(episodes))]  # fmt: skip


@pytest.mark.one_case
@pytest.mark.parametrize(
    ("members", "told"),
    [
        ([("old", "pick", 3)], "pick has old only"),
        ([("old", "pick", 3), ("old", "place", 3)], "pick has old only; place has old only"),
        ([("old", "pick", 3), ("new", "pikc", 3)], "pick has old only; pikc has new only"),
        ([("new", "pick", 3), ("other", "pick", 20), ("old", "place", 3)], "pick has new, other only; place has old"),
    ],
)
@pytest.mark.parametrize("asked", ["--fail-if", "--badge"])
def test_nothing_to_compare_is_an_error(tmp_path, members, told, asked):
    table(tmp_path, cells_of(members))
    arguments = [asked, *["worse"] * (asked == "--fail-if")]
    done = armctl("judge", "trials.csv", "--baseline", "old", *arguments, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert f"nothing was compared: {told}" in " ".join(done.stderr.split())
    assert armctl("judge", "trials.csv", "--baseline", "old", cwd=tmp_path).returncode == 0


def test_a_missing_pair_is_undecided(tmp_path):
    members = [("old", "pick", 3), ("new", "pick", 18), ("old", "place", 3)]
    judgement = judged(tmp_path, cells_of(members), baseline="old")
    assert [judgement.fails({outcome}) for outcome in ("undecided", "better", "worse")] == [True, True, False]
    assert "place has old only" in badge(judgement).splitlines()[1]
    complete = judged(tmp_path, cells_of([*members, ("new", "place", 18)]), baseline="old")
    assert not complete.fails({"undecided"})
    assert len(badge(complete).splitlines()) == 1


def test_no_pair_of_others_stands_for_one_with_the_baseline(tmp_path):
    members = [("new", "pick", 3), ("other", "pick", 20), ("new", "place", 3), ("old", "place", 3)]
    judgement = judged(tmp_path, cells_of(members), baseline="old")
    assert {conclusion.against for conclusion in judgement.conclusions} == {"old"}
    assert not judgement.fails({"better"})


@pytest.mark.parametrize("tasks", [["pick"], ["pick", "place"]])
def test_too_few_episodes_decide_nothing(tmp_path, tasks):
    members = [(policy, task, 9 * (policy == "old")) for task in tasks for policy in ("old", "new")]
    judgement = judged(tmp_path, cells_of(members, episodes=9), baseline="old")
    assert {end.outcome for ends in judgement.by_cell.values() for end in ends} == {"undecided"}
    assert judgement.fails({"worse"}) == (len(tasks) > 1)  # by all 18 episodes together
    assert not judged(tmp_path, ["policy,episode,success", "old,0,1"]).conclusions
    with pytest.raises(ConfigurationError, match="nothing was compared"):
        judged(tmp_path, ["policy,episode,success", "old,0,1"]).fails({"worse"})


def test_an_interval_for_all_pairs_says_so_where_it_contradicts_a_corrected_p(tmp_path):
    won = {"base": 8, "a": 40, "b": 40, "c": 17}
    lines = ["policy,success", *(f"{name},{int(k < n)}" for name, n in won.items() for k in range(40))]
    judgement = judged(tmp_path, lines, baseline="base")
    told = [str(conclusion) for conclusion in judgement.conclusions]
    assert told[-1].startswith("c 42.5 % against base 20.0 %: better, +22.5 points [-")
    assert ["interval for 3 pairs at once" in text for text in told] == [False, False, True]
    assert "p = 0.033 (on different episodes; Holm, 3 tests; interval for 3 pairs at once)." in (
        str(judgement.overall.verdict)
    )
    assert str(judgement.overall.verdict).count("at once") == 1


LONG = "x" * 300


@pytest.mark.parametrize(
    "line",
    [["judge", LONG], ["judge", f"{LONG}.parquet"], ["judge", "trials.csv", "--out", LONG], ["log", LONG, "a", "b"]],
    ids=lambda line: "-".join(word[-12:] for word in line),
)
def test_a_name_that_no_file_can_have_is_a_line(tmp_path, line):
    (tmp_path / "trials.csv").write_text("policy,trial,success\n" + "".join(f"a,{i},1\nb,{i},0\n" for i in range(12)))
    done = armctl(*line, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert "File name too long" in done.stderr
    assert "Traceback" not in done.stderr

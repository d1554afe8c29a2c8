"""Files that people and programs damage: read as they are meant, or refused with file, line and reason."""

import json
import re

import numpy as np
import pytest

from armctl.core.errors import ConfigurationError
from armctl.judging import judge

from ..command_line import armctl

GOOD = "policy,episode,success\nold,1,yes\nold,2,no\nnew,1,yes\nnew,2,yes\n"
WON = {"old": 1, "new": 2}
"""Successes in `GOOD`."""

READ: dict[str, tuple] = {
    "semicolons": (GOOD.replace(",", ";"), ""),
    "tabs": (GOOD.replace(",", "\t"), ""),
    "pipes": (GOOD.replace(",", "|"), ""),
    "Excel says its delimiter": ("sep=;\n" + GOOD.replace(",", ";"), ""),
    "Windows line ends": (GOOD.replace("\n", "\r\n"), ""),
    "old Mac line ends": (GOOD.replace("\n", "\r"), ""),
    "no line end at the end": (GOOD.rstrip(), ""),
    "byte order mark": (b"\xef\xbb\xbf" + GOOD.encode(), ""),
    "UTF-16": (GOOD.encode("utf-16"), ""),
    "UTF-16 without a mark": (GOOD.encode("utf-16-le"), ""),
    "Latin-1": (GOOD.replace("old", "plänner").encode("latin-1"), "not UTF-8"),
    "blank lines": ("\n\n" + GOOD.replace("old,2", "\n,,\n  \nold,2"), ""),
    "comments": (
        "# typed on Monday\n" + GOOD.replace("new,1", "# after lunch\nnew,1"),
        "1 comments skipped, the first",
    ),
    "trailing delimiters": (GOOD.replace("\n", ",,\n"), ""),
    "spaces": (GOOD.replace(",", " , ").replace("old", " old "), ""),
    "quotes": (re.sub(r"([^,\n]+)", r'"\1"', GOOD), ""),
    "a quoted cell with a line end": (
        'policy,episode,success,remark\nold,1,yes,"slow,\nbut fine"\nold,2,no,\nnew,1,yes,\nnew,2,yes,\n',
        "not used: 'remark'",
    ),
    "capitals": (GOOD.upper(), ""),
    "mixed capitals": (GOOD.replace("new,2", "New,2"), "'New' and 'new' count as one policy"),
    "other names": (GOOD.replace("policy,episode,success", "Method,Trial #,Success? (y/n)"), "policy from 'Method'"),
    "camel case": (
        GOOD.replace("policy,episode,success", "policyName,episodeId,isSuccess"),
        "success from 'isSuccess'",
    ),
    "0 and 1": (GOOD.replace("yes", "1").replace("no", "0"), ""),
    "1.0 and 0.0": (GOOD.replace("yes", "1.0").replace("no", "0.0"), ""),
    "decimal commas": (GOOD.replace(",", ";").replace("yes", "1,0").replace("no", "0,0"), ""),
    "true and false": (GOOD.replace("yes", "True").replace("no", "FALSE"), ""),
    "words": (GOOD.replace("yes", "Success").replace("no", "failure"), ""),
    "ticks": (GOOD.replace("yes", "✓").replace("no", "✗"), ""),
    "German": (GOOD.replace("yes", "ja").replace("no", "nein"), ""),
    "counts as a spreadsheet writes numbers": ("policy;successes;trials\nold;1.0;2.0\nnew;2;2\n", "stand for"),
    "episodes as numbers of two kinds": (GOOD.replace("new,1", "new,01").replace("new,2", "new,2.0"), ""),
    "columns of counts": ("policy,successes,trials\nold,1,2\nnew,2,2\n", "stand for as many episodes"),
    "start poses": (GOOD.replace("episode", "Start pose"), "seed from 'Start pose'"),
    "counts": ("policy,success\nold,1/2\nnew,2 of 2\n", "stand for as many episodes"),
    "short rows": (GOOD.replace("policy,episode,success", "policy,episode,success,remark,light"), ""),
    "an empty return beside success": (
        "policy,success,return\nold,y,3\nold,n,\nnew,y,3\nnew,y,4\n",
        "the return is not used, since it is empty in 1 rows, the first in line 3",
    ),
    "times of successes only": (
        "policy,success,time\nold,y,3\nold,n,\nnew,y,3\nnew,y,4\n",
        "Mean time of successes: new 3.5 s, old 3 s",
    ),
    "a column of indices without a name": (
        ",policy,episode,success\n" + "".join(f"{i},{line}\n" for i, line in enumerate(GOOD.splitlines()[1:])),
        "",
    ),
}


@pytest.mark.parametrize("name", READ)
def test_what_is_meant_is_read(tmp_path, name):
    content, note = READ[name]
    content = content if isinstance(content, bytes) else content.encode()
    (tmp_path / "trials.csv").write_bytes(content)
    comparison = judge(tmp_path / "trials.csv").overall
    wins = {
        policy.policy.lower().replace("plänner", "old"): policy.outcomes.get("success", 0)
        for policy in comparison.policies
    }
    assert (wins, {policy.episodes for policy in comparison.policies}) == (WON, {2})
    assert any(note in remark for remark in comparison.notes) or not note


REFUSED: dict[str, tuple] = {
    "nothing": ("", "is empty: its first line should name the columns"),
    "blank lines only": ("\n \n", "is empty"),
    "names only": ("policy,success\n", "has no episode"),
    "no names": ("old,1,yes\nold,2,no\n", "no column of success, return or time.*Its columns are 'old', '1', 'yes'"),
    "no score": ("policy,episode\nold,1\n", "no column of success, return or time"),
    "no text": (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0", "cannot be read: it is no text"),
    "an empty success": (
        GOOD.replace("new,1,yes", "new,1,"),
        "line 4: success: empty: enter yes or no, or remove the row",
    ),
    "half a success": (GOOD.replace("no", "half"), "line 3: success: 'half' is neither yes nor no"),
    "a column of rates": (
        "policy,success_rate\nold,0.85\n",
        "'success_rate' is a rate, .* or the counts, such as 17/20",
    ),
    "a rate": (
        "policy,success\nold,0.85\nnew,0.9\n",
        "line 2: success: 0.85 is a rate .* a row is needed for each episode",
    ),
    "a rate in percent": ("policy,success\nold,85 %\nnew,90 %\n", "line 2: success: 85 % is a rate"),
    "impossible counts": (
        "policy,success\nold,21/20\n",
        "line 2: success: 21/20: there cannot be 21 successes in 20 trials",
    ),
    "an empty policy": (GOOD.replace("old,2", ",2"), "line 3: the policy is empty"),
    "an empty episode": (GOOD.replace("old,2", "old,"), "line 3: the episode is empty"),
    "a trial twice": (GOOD + "new,2,yes\n", "line 6: episode 2 of new is there before, in .*trials.csv, line 5"),
    "a seed of trainings": (
        "policy,seed,success\nold,1,y\nold,1,n\n",
        "line 3: seed 1 of old .* say --training-seed-column",
    ),
    "a long row": (GOOD.replace("old,2,no", "old,2,no,4"), "line 3: it has 4 cells, more than the 3 columns"),
    "an open quotation mark": (GOOD.replace("old,2", '"old,2'), "line 3: a quotation mark .* opens here"),
    "an empty return": ("policy,return\nold,3\nold,\n", "line 3: the return is empty"),
    "a word for a return": ("policy,return\nold,3\nold,good\n", "line 3: return: 'good' is not a number"),
    "an infinite return": ("policy,return\nold,3\nold,inf\n", "line 3: return: 'inf' is not a number"),
    "a huge return": ("policy,return\nold,3\nold,1e300\n", r"line 3: return: 1e\+300 is no number to compare"),
    "a time on a clock": ("policy,time\nold,0:35\n", "line 2: time: '0:35' is not a number"),
    "a negative time": ("policy,time\nold,-3\n", "line 2: time: -3 is less than 0"),
    "a date as time": ("policy,success,time\nold,y,1700000000.5\n", "line 2: time: 1.7e.09 s is more than a day"),
    "columns that may be of policies or of measures": (
        "trial,grasped,dropped\n1,yes,no\n2,yes,yes\n",
        "no column of success.* or --policies-in-columns if each policy has a column",
    ),
    "counts that are thousands or not": (
        "policy;successes;trials\nold;20;1.050\nnew;21;1.050\n",
        "line 2: '1.050' is no number of episodes",
    ),
    "counts that are none": ("policy,successes,trials\nold,1.5,3\n", "line 2: '1.5' is no number of episodes"),
    "an unclear point": (
        "policy;success;steps\nold;y;900\nold;y;1.100\n",
        "line 3: steps: 1.100 may be 1.100 or 1100: write it without a point",
    ),
    "an unclear point after a tab": ("policy\treturn\nold\t2.345\n", "2.345 may be 2.345 or 2345"),
    "a row of totals among episodes": (GOOD + "new,Total,yes\n", "line 6: 'Total' as episode sums up other rows"),
    "a policy that is a row of totals": (GOOD + "Mean,1,yes\n", "line 6: 'Mean' as policy sums up other rows"),
    "a task of totals": (
        "policy,task,success\nold,a,3/4\nold,total:,3/4\n",
        "line 3: 'total:' as task sums up other rows",
    ),
    "one episode in two ways": (GOOD + "new,02,yes\n", "line 6: episode 2 of new is there before"),
    "half a step": ("policy,success,steps\nold,y,3.5\n", "line 2: steps: 3.5 is not a whole number"),
    "an unclear comma": (
        'policy,return\nold,"1,234"\n',
        "line 2: return: 1,234 may be 1.234 or 1234: write it without a comma",
    ),
    "both decimal signs": ("policy;return;time\nold;1,5;2.25\n", r"both the comma \(1,5\) and the point \(2.25\)"),
    "two columns for one thing": (
        "method,agent,success\na,b,y\n",
        "'method' and 'agent' may be the policy: say which, --policy-column",
    ),
    "two columns of one name": ("policy,success,success\na,y,n\n", "two columns are called 'success'"),
    "JSON that is cut off": ("trials.json", '[{"policy": "old", "success": true}, {"poli', "line 1: it is not JSON"),
    "JSON of numbers": ("trials.json", "[1, 2]", "episode 1: it is 1, not an object of named values"),
    "JSON without a list": ("trials.json", '{"success_rate": 0.8}', "it has no list of episodes"),
    "JSON, columns of different lengths": ("trials.json", '{"policy": ["a"], "success": [1, 0]}', "differ in length"),
    "JSON, nested deeply": ("trials.json", "[" * 100_000, "nested too deeply|not JSON"),
    "a JSON line that is cut off": (
        "trials.jsonl",
        '{"policy": "old", "success": true}\n{"policy"',
        "line 2: it is not JSON",
    ),
    "LeRobot without its episodes": (
        "trials.json",
        '{"per_task": [{"task_id": 0}], "overall": {}}',
        "no whole result file of lerobot",
    ),
    "vla-eval without its episodes": (
        "trials.json",
        '{"harness_version": "1", "tasks": [{}]}',
        "no whole result file of vla_eval",
    ),
    "robo-evals without its config": (
        "trials.json",
        '{"schema": "robo-evals/report/1"}',
        "no whole result file of robo_evals",
    ),
    "an archive that is none": ("trials.npz", "PK\3\4 and no more", "cannot be read"),
    "a Parquet file that is none": ("trials.parquet", "PAR1", "cannot be read: it is no Parquet file"),
    "a spreadsheet itself": ("trials.xlsx", "PK\3\4", "armctl judge reads .csv, .tsv"),
    "a video": ("trials.mp4", "ftyp", "armctl judge reads .csv, .tsv"),
}


@pytest.mark.one_case
@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_clear_is_refused_in_one_line(tmp_path, name):
    *file, content, message = REFUSED[name]
    path = tmp_path / (str(file[0]) if file else "trials.csv")
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    if path.suffix == ".parquet":
        pytest.importorskip("pyarrow")
    with pytest.raises(ConfigurationError, match=message) as refused:
        judge(path)
    assert path.name in str(refused.value)
    assert "\n" not in str(refused.value)
    done = armctl("judge", path.name, cwd=tmp_path, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("armctl: ")
    assert "Traceback" not in done.stderr


def test_objects_in_an_archive_are_not_unpickled(tmp_path):
    np.savez(tmp_path / "evaluations.npz", timesteps=[1], results=np.array([[print]], object))
    with pytest.raises(ConfigurationError, match="cannot be read"):
        judge(tmp_path / "evaluations.npz")


@pytest.mark.parametrize("results", [np.zeros(3), np.zeros((0, 3)), np.zeros((2, 0)), np.zeros((1, 3))])
def test_evaluations_of_other_shapes_are_refused(tmp_path, results):
    np.savez(tmp_path / "evaluations.npz", timesteps=[1, 2], results=results)
    with pytest.raises(ConfigurationError, match="has no evaluations"):
        judge(tmp_path / "evaluations.npz")


@pytest.mark.parametrize("name", ["nowhere.csv", "nowhere", "a\0b.csv"])
def test_a_file_that_is_not_there(tmp_path, name):
    with pytest.raises(ConfigurationError, match="cannot be read"):
        judge(tmp_path / name)


def test_a_folder_without_results(tmp_path):
    with pytest.raises(ConfigurationError, match="has no results"):
        judge(tmp_path)
    (tmp_path / "notes.md").write_text("none")
    with pytest.raises(ConfigurationError, match="has no results"):
        judge(tmp_path)
    with pytest.raises(ConfigurationError, match="nothing to judge"):
        judge([])


def test_the_files_have_to_share_a_score(tmp_path):
    (tmp_path / "a.csv").write_text("success\ny\n")
    (tmp_path / "b.csv").write_text("return\n1\n")
    with pytest.raises(ConfigurationError, match="share neither success, nor return, nor time"):
        judge(tmp_path)
    (tmp_path / "b.csv").write_text("success,return\ny,1\n")
    assert any("return not used, as not all files have it" in note for note in judge(tmp_path).overall.notes)


@pytest.mark.parametrize(
    ("cells", "values"),
    [
        (["1.5", "-2", "3e2", ".5"], [1.5, -2.0, 300.0, 0.5]),
        (["1,5", "2"], [1.5, 2.0]),
        (["1.234,5", "12.345"], [1234.5, 12345.0]),
        (["1,234.5", "12,345"], [1234.5, 12345.0]),
        (["1 234,5", "2\u202f000"], [1234.5, 2000.0]),
        (["1'234.5", "7"], [1234.5, 7.0]),
        (["1.234", "2.5"], [1.234, 2.5]),
        (["1,234,567", "8"], [1234567.0, 8.0]),
        (["0,125", "1,234"], [0.125, 1.234]),
        (["\u22123", "+4"], [-3.0, 4.0]),
        (["1.234", "0.500"], [1.234, 0.5]),
        (["1.234", "1100"], [1.234, 1100.0]),
        (["1.234", "12.5"], [1.234, 12.5]),
    ],
)
def test_numbers_as_people_type_them(tmp_path, cells, values):
    (tmp_path / "trials.csv").write_text("\n".join(["policy;return", *(f"a;{cell}" for cell in cells)]))
    table = judge(tmp_path / "trials.csv").overall.results
    assert sorted(table.column("total_reward").tolist()) == sorted(values)


def test_three_digits_after_the_point_are_clear_where_a_comma_divides_cells(tmp_path):
    (tmp_path / "trials.csv").write_text("policy,return\na,1.234\na,900\n")
    table = judge(tmp_path / "trials.csv").overall.results
    assert sorted(table.column("total_reward").tolist()) == [1.234, 900.0]


def test_a_policy_may_be_a_mean(tmp_path):
    (tmp_path / "trials.csv").write_text(GOOD.replace("old", "mean"))
    assert {policy.policy for policy in judge(tmp_path / "trials.csv").overall.policies} == {"mean", "new"}


def test_columns_are_policies_if_that_is_said(tmp_path):
    (tmp_path / "trials.csv").write_text("trial,old,new\n1,yes,yes\n2,no,yes\n")
    comparison = judge(tmp_path / "trials.csv", policies_in_columns=True).overall
    assert {policy.policy: policy.outcomes.get("success") for policy in comparison.policies} == WON
    assert comparison.facts.paired
    assert any("a column for each policy: old, new" in note for note in comparison.notes)
    assert "old, new" in armctl("judge", "trials.csv", "--policies-in-columns", cwd=tmp_path).stdout


@pytest.mark.parametrize("name", ["id", "index", "no", "nr", "", "Unnamed: 0"])
def test_numbers_of_rows_are_no_pairs(tmp_path, name):
    files = [tmp_path / "old.csv", tmp_path / "new.csv"]
    for file, wins in zip(files, (10, 20), strict=True):
        file.write_text("\n".join([f"{name},success", *(f"{i},{int(i < wins)}" for i in range(30))]))
    assert not judge(files).overall.facts.paired
    if name:
        assert judge(files, {"episode": name}).overall.facts.paired


def test_json_may_have_any_python_values(tmp_path):
    records = [{"policy": "a", "success": value} for value in (True, False, 1, 0, 1.0, "yes", "NO")]
    (tmp_path / "trials.json").write_text("\ufeff" + json.dumps(records))
    assert judge(tmp_path / "trials.json").overall.policies[0].outcomes == {"success": 4, "failure": 3}

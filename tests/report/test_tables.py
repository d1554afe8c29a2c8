"""Tables of comparisons, sweeps and reproductions: in terminals of all widths, in pipes, in notebooks and in files."""

import csv
import dataclasses
import io
import itertools
import json
import re
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest
from rich.console import Console

from armctl.agents import Evaluation
from armctl.agents.costs import TrainingCost
from armctl.episodes.table import EpisodeTable
from armctl.report.formats import FORMATS, as_csv, as_json, latex, markdown
from armctl.report.reproduction import reproduction_document
from armctl.report.terminal import UNLIMITED, DocumentView, fitted_table, tables
from armctl.stats.difference import Difference, Simultaneous
from armctl.stats.intervals import Estimate, Superiority
from armctl.study import Sweep
from armctl.study.reproduce import Reproduction
from armctl.study.task_results import COLUMNS
from armctl.verdict.notebook import html_of
from armctl.verdict.summary import PolicySummary
from armctl.verdict.summary_tables import policy_table
from armctl.verdict.tables import Cell, Column, Document, Remark, Table, p_value, plain

from ..made_up_comparison import made_up

SHORT = ["reach_ik", "reach_ppo", "random"]
LONG = ["some/long/path/of/mine.py:resolved_rate", "/home/somebody/agents/first/agent.json", "random"]
TWINS = ["/home/somebody/agents/first/agent.json", "/home/somebody/agents/other/agent.json"]
SUCCESS = Estimate(0.995, 0.9722, 0.9991)
HOSTILE = ["<script>a_b</script>", "50% & $1 | #{2}~^\\", "[red]no[/] *so*"]


def summary_of(policy, success):
    values = {field.name: None for field in dataclasses.fields(PolicySummary)}
    known = {
        "policy": policy, "sees": "observation", "training": TrainingCost(1_503_232, 13.6, 1_503_232), "planned": 200,
        "episodes": 200, "infeasible": 0, "outcomes": {"reached": 199, "timeout": 1}, "success": success,
        "episode_return": Estimate(-1234.5, -2345.6, -123.4), "steps_to_goal": success and Estimate(14.4, 12.4, 16.3),
        "metrics": {"energy": Estimate(1.0, None, None)}, "decision_ms_p50": 0.054,
        "decision_ms_p99": 15.854,
        "decision_ms_max": 20.0, "solver_failures": 0, "worlds": 1, "workers": 1, "spared": (), "foresight": (),
        "interface": {}, "isolated": False,
    }  # fmt: skip
    return PolicySummary(**values | known)


def pair_of(a, b, p):
    gain, chance = Estimate(188.25, 187.1, 189.2), Superiority(Estimate(0.975, 0.955, 0.99), 1e-59)
    only_a = 0 if p is None else 197
    steps = p and Estimate(-2.7, -3.9, -1.5)
    at_once = Simultaneous(gain, chance.probability, steps)
    return Difference(
        a, b, (200, 200), gain, chance, steps, at_once, success_p=p, wins=(only_a, 0), only_a=only_a, neither=3
    )


def comparison_of(names, success=SUCCESS, p=3.8e-59):
    policies = [summary_of(name, success) for name in names]
    paired = [pair_of(a, b, p) for a, b in itertools.combinations(names, 2)]
    notes = ["mine/Odd-v0 does not obey its seed: episodes differ."]
    return made_up("armctl/ArmReach-v0", EpisodeTable(), policies, paired, notes, env_options={"robot": "ur3"})


def swept(names=SHORT, levels=9):
    rows = [
        ("delay", float(i), name, 100, 1 - i / 10, 0.1, 0.9, *[float(i)] * 6, 1e-59, -i / 10, "steps", "state", False)
        for i, name in itertools.product(range(levels), names)
    ]
    points = pd.DataFrame(rows, columns=list(COLUMNS))
    found = Sweep("armctl/ArmReach-v0", 0, {"delay": list(range(levels))}, {}, "", {}, {}, False)
    found.points = points
    return found


def printed(document, width):
    console = Console(file=(out := io.StringIO()), width=width)
    console.print(DocumentView(document))
    return out.getvalue()


def numbers_of(document):
    """All numbers in cells, as they should be printed."""
    cells = [cell for table in document.tables for row in table.rows for cell in row[1:]]
    return {line for cell in cells for line in (cell.text, cell.small) if line}


@pytest.mark.parametrize("width", [40, 60, 80, 100, UNLIMITED])
@pytest.mark.parametrize(
    "found",
    [*map(comparison_of, (SHORT, LONG, TWINS)), comparison_of(SHORT, None, None), swept(), swept(LONG)],
    ids=["short", "long", "twins", "without success", "sweep", "long sweep"],
)
def test_no_number_is_cut_at_any_width(found, width):
    document = found.document()
    text = printed(document, width)
    assert max(map(len, text.splitlines())) <= width
    words = " ".join(text.split())
    left_out = {heading for table in document.tables for heading in fitted_table(table, width)[1]}
    for table in document.tables:
        for row in table.rows:
            for column, cell in zip(table.columns[1:], row[1:], strict=True):
                if column.heading not in left_out:
                    assert cell.text in words
                    assert cell.small in words
    for heading in left_out:
        assert heading in words.partition("Left out at this width:")[2]


def test_names_are_shortened_from_the_left_and_stay_distinct():
    text = printed(comparison_of(LONG).document(), 80)
    assert "py:resolved_rate" in text
    assert "…" in text
    assert "…irst/agent.json" in printed(comparison_of(TWINS).document(), 80) or "first/agent.json" in text
    (table, _), wide = comparison_of(TWINS).document().tables, 90
    fitted, _ = fitted_table(table, wide)
    assert len({row[0] for row in fitted.rows}) == 2
    alike = [f"{'x' * i}/the/very/same/long/end/of/a/path/agent.json" for i in range(1, 4)]
    text = printed(comparison_of(alike).document(), 60)
    assert all(f"policy: {name}" in text for name in alike)  # stacked: whole names


def test_success_columns_are_there_only_if_success_is_known():
    with_success, without = (printed(comparison_of(SHORT, *how).document(), 100) for how in ((), (None, None)))
    for word in ("success", "only a / only b", "McNemar"):
        assert word in with_success
        assert word not in without
    assert "a is better" in without
    assert "97.5 %" in without
    assert "+188" in without


def test_a_sweep_without_success_is_shown_by_return():
    sweep = swept()
    sweep.points = sweep.points.assign(success=float("nan"))
    text = printed(sweep.document(), 100)
    assert "sign test" in text
    assert re.search(r"^return .*\n.*\nreach_ik +0.0 +1.0", text, re.MULTILINE)


def test_remarks_are_there_in_all_forms():
    document = comparison_of(SHORT).document()
    for text in (printed(document, UNLIMITED), as_json(document), html_of(document), latex(document)):
        assert "mine/Odd-v0 does not obey its seed: episodes differ." in text
        assert "reach_ik" in text.replace("\\", "")


def test_json_has_numbers_as_numbers_with_intervals():
    written = json.loads(as_json(comparison_of(SHORT).document()))
    policy, pair = written["policies"][0], written["differences"][0]
    assert policy["success"] == {"value": 0.995, "low": 0.9722, "high": 0.9991}
    assert pair["success_p"] == 3.8e-59
    assert (written["env"], written["env_options"], written["seed"]) == ("armctl/ArmReach-v0", {"robot": "ur3"}, 0)
    assert "reach_ik" in written["verdict"]
    nothing = Document([Table("a", "", [], [], [{"x": float("nan"), "y": (1, float("inf"))}])])
    assert json.loads(as_json(nothing))["a"] == [{"x": None, "y": [1, None]}]


def test_csv_is_one_table_that_pandas_reads():
    frame = pd.read_csv(io.StringIO(as_csv(comparison_of(SHORT).document())))
    policies, paired = frame[frame.table == "policies"], frame[frame.table == "differences"]
    assert policies.policy.tolist() == SHORT
    assert policies.success_low.tolist() == [0.9722] * 3
    assert paired.success_p.tolist() == [3.8e-59] * 3
    assert paired.return_difference_high.tolist() == [189.2] * 3
    points = pd.read_csv(io.StringIO(as_csv(swept().document())))
    pd.testing.assert_frame_equal(points.drop(columns="table"), swept().points, check_dtype=False)


def test_markdown_tables_have_as_many_cells_in_each_row():
    text = markdown(comparison_of(HOSTILE).document())
    for block in text.split("\n\n"):
        if block.startswith("|"):
            assert len({len(re.findall(r"(?<!\\)\|", line)) for line in block.splitlines()}) == 1
    assert "\\<script\\>a\\_b" in text
    assert "99.5 % \\[97.2 to 99.9\\]" in text


@pytest.mark.parametrize("end", ["\n", "\r", "\v", "\f", "\x1c", "\x85", "\u2028", "\n\n| a |\n"])
@pytest.mark.parametrize("form", [markdown, latex, lambda document: printed(document, 400)])
def test_a_name_of_many_lines_breaks_no_row(form, end):
    plain_names, broken_names = ([*SHORT[:-1], f"first{middle}last"] for middle in ("", end))
    plain_text, text = form(comparison_of(plain_names).document()), form(comparison_of(broken_names).document())
    assert len(text.splitlines()) == len(plain_text.splitlines())
    assert end not in text or end == "\n"


def test_headings_titles_and_remarks_are_one_line():
    table = Table("key", "a\nb", [Column("c\rd")], [[Cell("e\nf", "g\nh")]], [], "i\n\nj")
    shown = [
        table.title,
        table.columns[0].heading,
        table.caption,
        Remark("k\nl").text,
        *vars(table.rows[0][0]).values(),
    ]
    assert shown == ["a\\nb", "c\\rd", "i\\n\\nj", "k\\nl", "e\\nf", "g\\nh"]


def test_latex_is_escaped_and_made_for_booktabs():
    text = latex(comparison_of(HOSTILE).document())
    code = "\n".join(line for line in text.splitlines() if not line.startswith("%"))
    assert r"50\% \& \$1 | \#\{2\}\textasciitilde{}\textasciicircum{}\textbackslash{}" in code
    assert r"1.1$\times10^{-58}$" in code
    assert r"\footnotesize $-$2346 to $-$123" in code
    assert not re.search(r"(?<!\\)[%#_]", code)
    assert code.count(r"\begin{tabular}") == code.count(r"\bottomrule") == 2
    for row in re.findall(r"\\midrule\n(.*?)\\bottomrule", code, re.DOTALL)[0].splitlines():
        if row.strip() and "addlinespace" not in row:
            assert len(re.findall(r"(?<!\\)&", row)) == 7


def test_a_notebook_shows_tables_and_no_code():
    html = comparison_of(HOSTILE)._repr_html_()
    assert html.count("<table") == 2
    assert "<script" not in html
    assert "&lt;script&gt;a_b" in html
    assert "1.1e-58" in html
    assert html.count("color: inherit") == 2  # in the notebook's colours, also where tables have their own
    assert swept()._repr_html_().count("<table") == 1


def test_the_text_of_a_comparison_is_one_line():
    for found in (comparison_of(SHORT), swept(), comparison_of([])):
        assert "\n" not in repr(found)
        assert "armctl/ArmReach-v0" in repr(found)
    assert "No verdict" not in repr(comparison_of(SHORT))


def test_a_reproduction_is_shown_in_the_same_tables():
    card: Any = SimpleNamespace(name="mine", env="armctl/ArmReach-v0")
    claimed, found = (
        Evaluation(
            episodes=100, seed=0, success_rate=rate, success_interval=(rate - 0.05, rate), mean_return=1.0,
            mean_steps_to_goal=None,
        )
        for rate in (0.5, 0.4)
    )  # fmt: skip
    document = reproduction_document([Reproduction(card, claimed, found)])
    for width in (40, 80):
        text = " ".join(printed(document, width).split())
        for word in ("mine", "50.0 %", "45.0 to 50.0", "40.0 %", "no", "success 0.5 on the card, 0.4 now (-0.1)"):
            assert word in text
    (row,) = csv.DictReader(io.StringIO(as_csv(document)))
    assert (row["card_success_rate"], row["now_success_rate"], row["agrees"]) == ("0.5", "0.4", "False")
    assert json.loads(as_json(document))["agents"][0]["card"]["success_interval"] == [0.45, 0.5]


@pytest.mark.parametrize(
    ("estimate", "cell"),
    [
        (Estimate(88.33, 87.24, 89.43), Cell("88.3", "87.2 to 89.4")),
        (Estimate(-100.0, None, None), Cell("-100", "unknown")),
        (Estimate(0.0123, -0.001, 0.0456), Cell("0.012", "-0.001 to 0.046")),
        (Estimate(0.0, 0.0, 0.0), Cell("0.0", "0.0 to 0.0")),
        (Estimate(1.5e9, 1e9, 2e9), Cell("1.5e+09", "1e+09 to 2e+09")),
        (None, Cell("-")),
    ],
)
def test_numbers_have_the_digits_that_they_need(estimate, cell):
    assert plain(estimate) == cell


def test_p_values_that_are_tiny():
    assert (p_value(1e-59), p_value(0.0), p_value(0.5), p_value(None)) == ("1e-59", "< 1e-300", "0.5", "-")


def test_every_format_writes_every_document():
    for write in FORMATS.values():
        for found in (comparison_of(SHORT), comparison_of([]), swept(), Sweep("x", 0, {}, {}, "", {}, {}, False)):
            write(found.document())
    assert tables(comparison_of(SHORT)).document.parts
    assert as_csv(Document([Remark("nothing")])) == "\n"


def test_the_verdict_is_read_first_and_its_cost_is_that_of_the_table():
    document = comparison_of(SHORT).document()
    verdict, cost, table, *_ = document.parts
    assert (verdict.kind, cost.kind, table.key) == ("verdict", "verdict", "policies")
    assert verdict.text.startswith("reach_ik is better than reach_ppo" if "better" in verdict.text else "Undecided")
    assert "reach_ik 0.054 ms (99th percentile 16 ms)" in cost.text
    assert table.rows[0][[column.heading for column in table.columns].index("decision ms")].text == "0.054"
    assert [part.text for part in document.parts if getattr(part, "kind", "") == "verdict"] == [verdict.text, cost.text]


@pytest.mark.parametrize(
    ("episodes", "share", "told"), [(9, 33.6, False), (20, 16.8, True), (182, 2.0, True), (183, 2.0, False)]
)
def test_the_width_of_intervals_at_few_episodes_has_its_reason(episodes, share, told):
    policies = [dataclasses.replace(summary_of(name, SUCCESS), episodes=episodes) for name in SHORT]
    caption = policy_table("armctl/ArmReach-v0", 0, policies).caption
    reason = f"since {episodes} episodes without one do not exclude them in {share} % of episodes; 183 would"
    assert (reason in caption) == told

"""Tables in the README and the pages in docs/ are what commands print, and none is stale."""

import json
import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from armctl import DEFAULT_ENV
from armctl.policies import policy_names

from .command_line import armctl

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def test_tables_are_what_a_benchmark_prints(monkeypatch, tmp_path):
    benchmark = """
from rich.box import MARKDOWN
from rich.console import Console
from rich.table import Table
table = Table("", "share", box=MARKDOWN, title="no part of it")
table.add_row("armctl, a long name " * 5, "7%")
Console().print("Python", table, sep="\\n")
"""
    (tmp_path / "benchmarks").mkdir()
    (tmp_path / "benchmarks" / "one.py").write_text(benchmark)
    tables = runpy.run_path(str(ROOT / "benchmarks/tables.py"))
    renewed = tables["renewed"]
    monkeypatch.setitem(renewed.__globals__, "ROOT", tmp_path)
    page = "Before\n<!-- python benchmarks/one.py -->\nold\n<!-- end -->\nAfter\n"
    assert renewed(page, lambda block: "another" in block["command"]) == page
    once = renewed(page, lambda block: "one" in block["command"])
    assert "| | share |\n|---|---|\n| armctl, a long name armctl" in once
    assert "| 7 % |\n\n`python benchmarks/one.py`, 20" in once
    assert "old" not in once
    assert "no part of it" not in once
    assert renewed(once) == once


def in_this_process(words, folder, width="200"):
    """Run what the benchmark runs as a program, `-m armctl ...`."""
    return armctl(*words[2:], cwd=folder, COLUMNS=width).stdout


@pytest.mark.slow
def test_tables_are_what_a_comparison_prints(monkeypatch):
    renewed = runpy.run_path(str(ROOT / "benchmarks/tables.py"))["renewed"]
    command = "armctl compare reach_ik random --episodes 3 --policy-seed 0"
    once = renewed(f"Before\n<!-- {command} -->\nold\n<!-- end -->\nAfter\n")
    assert "| reach\\_ik, untrained | 100.0 % " in once
    assert "random: 3 timeout" in once
    assert "**No verdict from 3 episodes: at least 10 are needed.**" in once
    assert f"\n\n`{command}`, 20" in once
    assert "old" not in once
    assert "reach\\_ik - random" not in once
    assert "<!-- shows random " in once
    assert "- reach\\_ik: 3 reached" in once
    monkeypatch.setitem(renewed.__globals__, "_printed", in_this_process)
    brief = renewed(f"<!-- in short: {command} -->\n<!-- end -->\n")
    assert brief.startswith(
        f"<!-- in short: {command} -->\n\n> No verdict from 3 episodes: at least 10 are needed.\n\n"
        "| policy | success | return | steps | decision ms | sees |\n"
    )
    assert "3 reached" not in brief
    printed = renewed(f"<!-- as printed: {command} -->\n<!-- end -->\n")
    assert "-->\n\n```text\nNo verdict from 3 episodes: at least 10 are needed.\n\narmctl/ArmReach-v0: 3" in printed
    assert "results/test/episodes.csv has the episodes" in printed


@pytest.mark.slow
def test_tables_are_what_a_sweep_prints(monkeypatch):
    renewed = runpy.run_path(str(ROOT / "benchmarks/tables.py"))["renewed"]
    monkeypatch.setitem(renewed.__globals__, "_printed", in_this_process)
    command = "armctl sweep reach_ik random --episodes 2 --disturbance noise=0.02,0.05 --disturbance delay=2"
    once = renewed(f"<!-- {command} -->\nold\n<!-- end -->\n")
    heading = "| | undisturbed | noise 0.02 | noise 0.05 | delay 2 |\n|---|---|---|---|---|\n"
    assert once.count(heading) == 2
    assert f"{heading}| `reach_ik` | 100 | 100 | 100 | 100 |\n| `random` | 0 | spared | spared | 0 |\n\n95 %" in once
    assert "| `random` | 0 to 84 |  |  | 0 to 84 |" in once
    assert "\n\n> Under noise, no ranking: fewer than two policies are affected and tested; under delay, " in once
    assert f"\n\n`{command}`, 20" in once
    assert "<!-- shows random " in once


def test_every_table_of_benchmarks_has_its_command():
    block = runpy.run_path(str(ROOT / "benchmarks/tables.py"))["BLOCK"]
    for page in PAGES:
        for found in block.finditer(page.read_text()):
            command = found["command"] or "armctl "
            assert command.startswith("armctl ") or (ROOT / command.split()[1]).exists(), command
    assert not re.search(r"^\|", block.sub("", (ROOT / "docs/performance.md").read_text()), re.MULTILINE)


def test_every_figure_of_a_policy_comes_from_a_command():
    tables = runpy.run_path(str(ROOT / "benchmarks/tables.py"))
    figures = re.compile(rf"^\|[^|]*\b({'|'.join(policy_names())})\b[^|]*\|[^a-z]*\d[^a-z]*\|$", re.MULTILINE)
    for page in tables["PAGES"]:
        by_hand = figures.search(tables["BLOCK"].sub("", page.read_text()))
        assert by_hand is None, f"{page.name}: put it into a block of its command: {by_hand[0]}"


def test_no_table_is_older_than_a_policy_that_it_shows():
    assert list(runpy.run_path(str(ROOT / "benchmarks/tables.py"))["stale_blocks"]()) == []


def test_the_experts_figures_show_the_published_sweeps():
    figures = runpy.run_path(str(ROOT / "docs/make_robustness.py"))
    sweeps = figures["sweeps"]()
    rows = re.findall(r"^\| `([\w:=]+)` \| (.*) \|$", (ROOT / "docs/robustness.md").read_text(), re.MULTILINE)
    shown = [
        (name, " | ".join("spared" if np.isnan(value) else f"{value:.0f}" for value, *_ in success))
        for sweep in sweeps
        for name, success in zip(sweep.policies, sweep.success, strict=True)
    ]
    assert set(shown) <= set(rows)
    for page, policies in figures["PAGES"].items():
        assert set(policies) <= {name for name, _ in shown}, page
        assert (ROOT / "docs/experts" / f"{page}.png").exists()
        assert f"]({page}.png)" in (ROOT / "docs/experts" / f"{page}.md").read_text()


def test_a_table_is_stale_once_what_it_shows_is_another(monkeypatch, tmp_path):
    tables = runpy.run_path(str(ROOT / "benchmarks/tables.py"))
    block, stale = tables["BLOCK"], tables["stale"]
    command = "armctl compare reach_ik reach_ppo --seed test"
    shown = tables["checksums"](command, "")
    assert list(shown) == ["reach_ik", "reach_ppo", "test seed"]
    marks = ", ".join(f"{name} {checksum}" for name, checksum in shown.items())

    def found(marks, command=command):
        return stale(block.search(f"<!-- {command} -->\n| reach\\_ik |\n<!-- shows {marks} -->\n<!-- end -->"))

    assert found(marks) == []
    assert found(marks.replace(shown["reach_ppo"], "00000000")) == ["reach_ppo"]
    assert found(marks.partition(", ")[0]) == ["reach_ppo", "test seed"]
    assert found(marks, command.replace("reach_ppo", "reach_mpc")) == ["reach_ppo", "reach_mpc"]
    assert stale(block.search("<!-- record of 2026-11-25: why -->\n| reach_ik |\n<!-- end -->")) == []
    for path in ("benchmarks/golden.json", "rl/agents/seeds/reach_ppo-0.onnx"):
        (tmp_path / path).parent.mkdir(parents=True)
        (tmp_path / path).write_bytes((ROOT / path).read_bytes())
    monkeypatch.setitem(stale.__globals__, "ROOT", tmp_path)
    tables["_checksum_of"].cache_clear()
    assert found(marks) == ["reach_ppo"]  # fewer trainings
    golden = json.loads((ROOT / "benchmarks/golden.json").read_text())
    golden[f"{DEFAULT_ENV} {{}} reach_ik"]["lengths"][0] += 1
    (tmp_path / "benchmarks/golden.json").write_text(json.dumps(golden))
    tables["_checksum_of"].cache_clear()
    assert found(marks) == ["reach_ik", "reach_ppo"]


def test_of_a_suite_pages_have_the_headline_and_the_map():
    of_suite = runpy.run_path(str(ROOT / "benchmarks/tables.py"))["of_suite"]
    parts = [
        "**Of 1 task, by success: undecided in ArmReach.**", "**Which kind leads**", "| task | none | delay \\(1\\) |",
        "C, L: a legend", "**1 tasks: 20 episodes**", "| task | classical |",
    ]  # fmt: skip
    assert of_suite(parts) == ["> Of 1 task, by success: undecided in ArmReach.", *parts[2:4]]


def test_of_worst_cases_pages_have_the_table_and_its_caption():
    pattern = runpy.run_path(str(ROOT / "benchmarks/tables.py"))["WITHOUT_WORST_CASES"]
    assert pattern.match("**Worst cases in armctl/ArmReach-v0**")
    assert pattern.match("reach\\_ik fails in episode 3: armctl view reach\\_ik")
    assert not pattern.match("| policy | distance |")
    assert not pattern.match("Distance of the mildest disturbance")

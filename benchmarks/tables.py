"""The published tables are made by the commands below them.

    python benchmarks/tables.py                  # all of them: hours, on a machine that does nothing else
    python benchmarks/tables.py ik optimality    # those of the commands that contain one of these words

A page names the command between two comments. What lies between them is replaced by what the command prints: the tables
of a benchmark, or the results and the verdict of a comparison, without the table of pairs:

    <!-- python benchmarks/ik.py -->
    <!-- end -->

    <!-- armctl compare reach_ik reach_ppo --seed 2026 -->
    <!-- end -->
"""

import datetime
import itertools
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Collection
from pathlib import Path
from tempfile import TemporaryDirectory

import armctl

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(r"^<!-- ((?:python benchmarks/|armctl ).*?) -->$.*?^<!-- end -->$", re.MULTILINE | re.DOTALL)
WIDTH = "400"
"""Characters of the terminal that a benchmark gets, so that no cell is wrapped."""


def renewed(page: str, words: Collection[str] = ()) -> str:
    """A page with new tables from the commands that contain one of the words, or from all."""
    return BLOCK.sub(lambda block: _run(block[1]) if _is_asked(block[1], words) else block[0], page)


def _is_asked(command: str, words: Collection[str]) -> bool:
    return not words or any(word in command for word in words)


def _run(command: str) -> str:
    print(f"{command} ...", flush=True)
    program, *words = shlex.split(command)
    with TemporaryDirectory() as folder:
        started = ["-m", "armctl", *words, "--format", "markdown", "--out", f"{folder}/results"]
        done = subprocess.run(
            [sys.executable, *(started if program == "armctl" else words)], cwd=ROOT,
            env=os.environ | {"COLUMNS": WIDTH}, stdout=subprocess.PIPE, text=True, check=True,
        )  # fmt: skip
    parts = (
        f"<!-- {command} -->",
        *(results(done.stdout) if program == "armctl" else tables(done.stdout)),
        f"`{command}`, {datetime.date.today()}, armctl {armctl.__version__}",
        "<!-- end -->",
    )
    return "\n\n".join(parts)


def results(printed: str) -> list[str]:
    """A comparison in Markdown, without titles and the table of pairs; how episodes ended is a list."""
    paragraphs = [part.strip() for part in printed.split("\n\n")]
    dropped = re.compile(r"\*\*[^\n]*episodes of seed|\*\*Paired|\| a - b|p: McNemar")
    return [re.sub(r"^(\S+: \d)", r"- \1", part) for part in paragraphs if not dropped.match(part)]


def tables(printed: str) -> list[str]:
    """The Markdown tables in what a benchmark prints, without the padding, and with a space before %."""
    lines = map(_narrow, printed.splitlines())
    groups = itertools.groupby(lines, lambda line: line.startswith("|"))
    return ["\n".join(group) for is_table, group in groups if is_table]


def _narrow(line: str) -> str:
    for pattern, plain in ((r"-+\|", "---|"), (r" +", " "), (r"(?<=\d)%", " %")):
        line = re.sub(pattern, plain, line.strip())
    return line


if __name__ == "__main__":
    for path in sorted((ROOT / "docs").glob("*.md")):
        page = path.read_text()
        if (new := renewed(page, sys.argv[1:])) != page:
            path.write_text(new)

import re
import subprocess
import sys
from pathlib import Path

import pytest

from armctl.policies import policy_names

README = (Path(__file__).parents[1] / "README.md").read_text()
EXAMPLES = re.findall(r"```python\n(.*?)```", README, re.DOTALL)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.strip().splitlines()[-1][:40])
def test_example_runs(example):
    done = subprocess.run(
        [sys.executable, "-W", "error::DeprecationWarning", "-c", example], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_there_are_examples():
    assert len(EXAMPLES) >= 4


def test_every_folder_and_file_of_the_map_exists():
    root = Path(__file__).parents[1]
    area = README.split("## Where things are")[1].split("```")[1]
    for indent, name in re.findall(r"^( *)([\w/.]+)", area, re.MULTILINE):
        assert (root / ("src/armctl" if indent else "") / name).exists(), name
    mapped = set(re.findall(r"^ +(\w+)", area, re.MULTILINE))
    there = {path.stem for path in (root / "src/armctl").iterdir() if not path.name.startswith(("_", "py.typed"))}
    assert there == mapped


def test_every_policy_is_said_what_it_sees():
    table = README.split("## Who is in it")[1].split("##")[0]
    said = [
        name
        for row in re.findall(r"^\|([^|]+)\|[^|]+\|[^|]+\|$", table, re.MULTILINE)
        for name in re.findall(r"`(\w+)`", row)
    ]
    assert sorted(said) == policy_names()


def test_every_link_and_picture_is_there():
    root = Path(__file__).parents[1]
    headings = {
        re.sub(r"[^\w -]", "", line).strip().lower().replace(" ", "-")
        for line in re.findall(r"^#+ (.*)$", README, re.MULTILINE)
    }
    for link in re.findall(r"\]\(([^)]+)\)", README):
        there = link[1:] in headings if link.startswith("#") else link.startswith("https://") or (root / link).exists()
        assert there, link

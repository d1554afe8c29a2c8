"""The README is a door, not the house; `test_docs.py` checks its examples, names and links."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def test_it_is_short():
    assert len(README.splitlines()) <= 180


def test_it_leads_to_every_page_and_notebook():
    links = set(re.findall(r"\]\(([^)#]+)", README))
    pages = {
        str(path.relative_to(ROOT)) for pattern in ("docs/*.md", "notebooks/*.ipynb") for path in ROOT.glob(pattern)
    }
    assert pages <= links


def test_it_counts_the_agents():
    agents = list((ROOT / "rl" / "agents").glob("*.json"))
    assert len(agents) == 16
    assert "sixteen trained ones" in README

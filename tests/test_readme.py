"""The README is a door, not the house; `test_docs.py` checks its examples, names and links."""

import re
from pathlib import Path

from armctl.core.registration import environment_names
from armctl.policies import agent_cards
from armctl.policies.catalogue import listed_policies
from armctl.robot_description import BUILTIN_ARMS

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


def test_it_counts_what_there_is():
    numbers = {
        6: "six", 7: "seven", 8: "eight", 9: "nine", 10: "ten", 11: "eleven", 16: "sixteen", 17: "seventeen",
        20: "twenty", 21: "twenty-one", 23: "twenty-three", 24: "twenty-four", 25: "twenty-five",
        26: "twenty-six", 27: "twenty-seven", 28: "twenty-eight", 29: "twenty-nine",
        30: "thirty", 31: "thirty-one", 32: "thirty-two", 33: "thirty-three", 34: "thirty-four",
    }  # fmt: skip
    agents = agent_cards()
    experts = [policy for policy in listed_policies() if policy.kind == "expert"]
    envs = [name for name in environment_names() if name.startswith("armctl/")]  # other tests add some
    assert (
        f"`armctl list` shows all {numbers[len(envs)]} environments, {numbers[len(BUILTIN_ARMS)]} arms, "
        f"{numbers[len(experts)]} experts and {numbers[len(agents)]} trained agents."
    ) in README
    assert f"{numbers[len(agents)]} trained ones" in README

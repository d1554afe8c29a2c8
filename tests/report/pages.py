"""What a page says and shows, and results for it."""

import json
import re
from html import unescape

POLICIES = ["reach_ik", "reach_ppo", "random"]

OPTIONS = {"max_episode_steps": 15}
"""Enough for the experts: each decision is a picture in a video."""


def text_of(page):
    """What a reader sees, without scripts, styles and tags."""
    html = re.sub(r"<(script|style)\b.*?</\1>", "", page.read_text(), flags=re.DOTALL)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]*>", " ", html)))


def plots_of(report):
    """The figures, by what they say to those who do not see them."""
    written = re.findall(
        r'aria-label="([^"]*)" style="[^"]*"></div>\s*<script type="application/json">(.*?)</script>',
        report.read_text(),
        re.DOTALL,
    )
    return {unescape(says): json.loads(figure) for says, figure in written}


def plot_of(report, says):
    return next(figure for name, figure in plots_of(report).items() if says in name)

"""What a page says and shows, and results for it."""

import json
import re
from html import unescape

POLICIES = ["reach_ik", "reach_ppo", "random"]

OPTIONS = {"max_episode_steps": 15}
"""Enough for the experts: each decision is a picture in a video."""

SWEEP = "disturbance,level,policy,success,low,high,episodes\n" + "".join(
    f"{kind},{level},{policy},{0.9 - level},{0.8 - level},{1 - level},20\n"
    for kind in ("noise", "delay")
    for level in (0, 0.1, 0.3)
    for policy in ("reach_ik", "reach_bc")
)


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

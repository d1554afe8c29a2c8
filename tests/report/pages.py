"""What a page says."""

import re
from html import unescape


def text_of(page):
    """What a reader sees, without scripts, styles and tags."""
    html = re.sub(r"<(script|style)\b.*?</\1>", "", page.read_text(), flags=re.DOTALL)
    return re.sub(r"\s+", " ", unescape(re.sub(r"<[^>]*>", " ", html)))

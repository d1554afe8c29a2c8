"""Notebooks as pages of Markdown, with their stored outputs: nothing is executed."""

import base64
import io
import json
import re
from pathlib import Path
from typing import Any

from matplotlib import mathtext
from matplotlib.font_manager import FontProperties

FORMULA = re.compile(r"\$\$(.+?)\$\$|\$(.+?)\$", re.DOTALL)


def as_markdown(notebook: Path) -> tuple[str, dict[str, bytes]]:
    """Return the page, and its pictures by file name."""
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in json.loads(notebook.read_text())["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(FORMULA.sub(_drawn, source))
            continue
        parts.append(f"```python\n{source}\n```")
        for output in cell["outputs"]:
            data = output.get("data", {})
            if "image/png" in data:
                name = f"{notebook.stem}_{len(pictures)}.png"
                pictures[name] = base64.b64decode("".join(data["image/png"]))
                parts.append(f"![Output of the cell above]({name})")
            elif "text/html" in data:
                parts.append(_table("".join(data["text/html"])))
            else:
                parts.append(f"```text\n{_text(output)}\n```")
    return "\n\n".join(parts) + "\n", pictures


def _text(output: dict[str, Any]) -> str:
    return "".join(
        output["text"] if "text" in output else output["data"]["text/plain"]
    ).rstrip()


def _table(html: str) -> str:
    """Return a table of pandas without its own style."""
    return re.sub(r"<style.*?</style>|\n\s*", "", html, flags=re.DOTALL)


def _drawn(formula: re.Match[str]) -> str:
    """Return a formula as an SVG, which needs no script."""
    block, inline = formula.groups()
    tex = (block or inline).replace(r"\top", "T").strip()
    svg = io.StringIO()
    mathtext.math_to_image(
        f"${tex}$", svg, prop=FontProperties(size=12), format="svg"
    )
    picture = re.sub(
        r"^.*?(?=<svg)|<metadata>.*?</metadata>|\n\s*",
        " ",
        svg.getvalue(),
        flags=re.DOTALL,
    ).strip()
    return f'<span class="formula{" block" if block else ""}" role="img" aria-label="{tex}">{picture}</span>'

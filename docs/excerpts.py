"""Excerpts of code in the pages: `python docs/excerpts.py` updates these copies after the code has changed.

A fence names a file and what to show of it, such as `python docs/examples/hover.py HoverTask.reset`: a class, a
function, a method, a variable, a call, or all from one to another (`HoverTask.options_type..HoverTask.render_fps`).
"""

import ast
import re
import textwrap
from pathlib import Path

FOLDER = Path(__file__).parent
FENCE = re.compile(
    r"^```python (\S+/\S+\.py) (\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL
)


def renewed(page: str) -> str:
    """Return a page with updated excerpts."""
    return FENCE.sub(
        lambda fence: (
            f"```python {fence[1]} {fence[2]}\n{excerpt(fence[1], fence[2])}\n```"
        ),
        page,
    )


def excerpt(file: str, names: str) -> str:
    """Return the lines of a file from the first of the names, which are joined by `..`, to the end of the last."""
    source = (FOLDER.parent / file).read_text()
    first, last = (
        (names.split("..") * 2)[i] for i in (0, 1 if ".." in names else 0)
    )
    start, end = _lines(source, first)[0], _lines(source, last)[1]
    return textwrap.dedent("\n".join(source.splitlines()[start - 1 : end]))


def _lines(source: str, name: str) -> tuple[int, int]:
    """Return the first and the last line of a statement, with its decorators."""
    body: list[ast.stmt] = ast.parse(source).body
    for part in name.split("."):
        node = next((node for node in body if part in _names(node)), None)
        if node is None:
            raise LookupError(f"there is no {name}")
        body = getattr(node, "body", [])
    assert node is not None
    start = min(
        [
            node.lineno,
            *(
                decorator.lineno
                for decorator in getattr(node, "decorator_list", ())
            ),
        ]
    )
    return start, node.end_lineno or start


def _names(node: ast.stmt) -> set[str]:
    """Return the names that a statement defines, or the function that it calls."""
    if isinstance(node, ast.ClassDef | ast.FunctionDef):
        return {node.name}
    if (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Call)
        and isinstance(node.value.func, ast.Name)
    ):
        return {node.value.func.id}
    return {
        one.id
        for one in ast.walk(node)
        if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)
    }


if __name__ == "__main__":
    for page in sorted(FOLDER.glob("*.md")):
        page.write_text(renewed(page.read_text()))

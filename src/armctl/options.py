"""Options as they are written: on the command line, and in results."""

import ast
from typing import Any


def option_value(text: str) -> Any:
    """A number, tuple, True, False or None as Python writes it; anything else is text."""
    try:
        return ast.literal_eval(text)
    except (ValueError, TypeError, SyntaxError, MemoryError, RecursionError):
        return text

"""Output of armctl in a terminal: all strings are text, neither markup nor control sequences.

Names and messages come from files, and files from strangers. `[red]` is shown as it is, and the escape sequences by
which a text could hide lines, forge others or write to the clipboard are shown as escapes.
"""

import re
from collections.abc import Iterable
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

CONTROLS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""Control characters except tabs and line feeds; what turns the direction of writing; halves of characters."""
SECRETS = re.compile(
    r"(?<=\w://)(?:[^\s/@:[]*:(?!\d{1,5}/)[^\s@]*|[^\s/@:]+)(?:@[^\s/@]*)*(?=@)|(?<=[?&]password=)[^\s&]+"
)
"""User and password in an address, such as `u:p` in `postgresql://u:p@host/db`."""


def printable(text: str) -> str:
    r"""Return a text as a terminal may have it: control characters are escapes, such as `\x1b`, and secrets `***`."""
    return CONTROLS.sub(lambda match: match[0].encode("unicode_escape").decode(), SECRETS.sub("***", text))


class PlainConsole(Console):
    """A console to which all strings are text. Colours are those of `Text` and of other renderables."""

    def __init__(self, *, stderr: bool = False, width: int | None = None) -> None:
        super().__init__(stderr=stderr, width=width, markup=False, emoji=False)

    def render_str(self, text: str, **options: Any) -> Text:
        """Return a string as text without secrets, before it is divided for its colours."""
        return super().render_str(SECRETS.sub("***", text), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render with escapes instead of control characters."""
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(printable(segment.text), segment.style)

"""The report's colours, each in a version for white pages and one for dark pages.

Figures are written in the light colours. The page's script replaces them by `DARK` on a dark page.
"""

INK, PALE, GRID, LINE, PAPER, ALARM = "#1f2933", "#6b7680", "#e4e8ec", "#aab3bb", "#ffffff", "#b42318"
"""Text, small text, grid lines, axes, background, limits."""
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#5a5a5a")
"""Colours of policies, by Okabe and Ito (2008): safe for colour-blind readers."""
FAMILY_COLOURS = (*COLOURS[:6], "#332288", "#882255", "#999933", "#7b4b2a", INK)
"""Colours of families of methods: those of policies but for the grey one, and some of Tol (2021)."""
TERM_COLOURS = ("#b9b4a7", "#44aa99", "#882255", "#ddcc77", "#332288", "#88ccee", "#999933", "#aa4499")
"""Colours of reward terms, by Tol (2021); different from those of policies."""


def faint(colour: str) -> str:
    """Return a transparent version of a colour #rrggbb."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.16)"


_LIGHTER = {
    INK: "#e6eaee", PALE: "#98a4af", GRID: "#2b333b", LINE: "#56626d", PAPER: "#171c21", ALARM: "#ff7b6b",
    "#0072b2": "#3d9be0", "#d55e00": "#f58442", "#009e73": "#2ec99c", "#cc79a7": "#e29ac3", "#e69f00": "#f4bd3f",
    "#56b4e9": "#9bd6ff", "#5a5a5a": "#b3b3b3", "#882255": "#c2568a", "#332288": "#8a7be0", "#aa4499": "#d98acc",
    "#7b4b2a": "#c08a60",
}  # fmt: skip
"""Dark colours as light as it takes on a dark page. The others are readable on both."""
DARK = _LIGHTER | {faint(colour): faint(_LIGHTER[colour]) for colour in COLOURS}
"""Colours on a dark page, by their light version."""


def on_both(colour: str) -> str:
    """Return a colour for CSS: light on a dark page, dark on a white one."""
    return f"light-dark({colour}, {DARK.get(colour, colour)})"

"""The diagram of the architecture, `architecture.svg`: python docs/make_architecture.py.

Floors are those that import-linter checks, `[tool.importlinter]` in pyproject.toml.
"""

import tomllib
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import escape

ROOT = Path(__file__).parents[1]
SVG = ROOT / "docs" / "architecture.svg"
WIDTH, ROW, GAP, MARGIN, LEGEND = 980, 38, 8, 10, 46
"""Sizes in pixels: of the picture, a floor, the room between two, the rim, and the legend."""

PLUG_IN, STUDY, BELIEF, TRUTH, SHARED = (
    "#f3e3c3",
    "#d9e7f7",
    "#d8efdb",
    "#f6d5d1",
    "#e8e8ec",
)
COLOURS = {
    PLUG_IN: "plug-ins, by entry point",
    STUDY: "from cells to verdicts",
    BELIEF: "what controllers believe",
    TRUTH: "what is true",
    SHARED: "shared",
}
EPISODE, ACTION = "#1c5fa8", "#b3541e"


class Package(NamedTuple):
    """A package's text, colour, and its places in the two walks."""

    text: str
    colour: str = SHARED
    episode: str = ""
    action: str = ""


PACKAGES = {
    "cli": Package("the verbs", STUDY, "1"),
    "rl": Package("learners, agents", PLUG_IN),
    "baselines": Package("experts", PLUG_IN, action="b"),
    "report": Package("tables, HTML", STUDY, "9"),
    "integrations": Package("hub, trackers, LeRobot, Rerun, SB3", STUDY),
    "viewer": Package("a policy live", STUDY),
    "datasets": Package("demonstrations", STUDY),
    "tuning": Package("search", STUDY),
    "training": Package("recipes, trainings", STUDY),
    "judging": Package("results made anywhere", STUDY),
    "study": Package("policies x cells: plan, loop, results", STUDY, "2"),
    "verdict": Package("summaries, sentences, tables", STUDY, "8"),
    "stats": Package("intervals, tests", STUDY, "7"),
    "rollout": Package("the episode loop", STUDY, "5"),
    "episodes": Package("an episode, the table, the store", STUDY, "6"),
    "runtime": Package("workers, clusters, provenance", STUDY),
    "shaping": Package("potentials as rewards"),
    "policies": Package("what a policy is, and sees", action="a", episode="3"),
    "agents": Package("ONNX and JSON"),
    "envs": Package("Gymnasium's interface, n worlds", TRUTH, "4", "c"),
    "tasks": Package("reset, observation, reward, outcome", TRUTH, action="e"),
    "environments": Package("registers ids", TRUTH),
    "disturbances": Package("noise, delay, payload, ...", TRUTH, action="d"),
    "planning": Package("paths", BELIEF),
    "estimation": Package("filters, delays, maps", BELIEF),
    "control": Package("MPC, pursuit", BELIEF),
    "kinematics": Package("FK, IK, clearance", BELIEF),
    "robots": Package("command and sensors", TRUTH, action="f"),
    "simulation": Package("n MuJoCo worlds at once", TRUTH, action="g"),
    "robot_description": Package("URDF, limits, capsules"),
    "scene": Package("boxes, people, map"),
    "kernels": Package("compiled arithmetic", action="h"),
    "remote": Package("messages to other processes"),
    "core": Package("errors, files, options, seeds, terminal"),
}


def floors() -> list[list[str]]:
    """Return the packages of each floor, from top to bottom."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"][
        "importlinter"
    ]["contracts"]
    layers = next(
        contract["layers"]
        for contract in settings
        if contract["type"] == "layers"
    )
    return [layer.split(" | ") for layer in layers]


def mark(x: float, y: float, text: str, colour: str) -> str:
    """Return a place in a walk: a white character on a disc."""
    return (
        f'<circle cx="{x}" cy="{y}" r="10" fill="{colour}"/>'
        f'<text x="{x}" y="{y + 4}" text-anchor="middle" fill="white" font-weight="bold">{text}</text>'
    )


def box(name: str, x: float, y: float, width: float) -> str:
    """Return a package: its name, its text, and its places in the walks."""
    package = PACKAGES[name]
    places = [(package.episode, EPISODE), (package.action, ACTION)]
    marks = [
        mark(x + width - 16 - 24 * i, y + ROW / 2, *place)
        for i, place in enumerate(p for p in places if p[0])
    ]
    return (
        f'<rect x="{x}" y="{y}" width="{width}" height="{ROW}" rx="5" fill="{package.colour}" stroke="#888"/>'
        f'<text x="{x + 10}" y="{y + ROW / 2 + 4}"><tspan font-weight="bold">{name}</tspan>'
        f'<tspan dx="8" fill="#444">{escape(package.text)}</tspan></text>{"".join(marks)}'
    )


def drawing() -> str:
    """Return the diagram as SVG."""
    parts, y = [], float(MARGIN)
    for floor in floors():
        shares = [
            60 + 7.2 * len(name) + 6 * len(PACKAGES[name].text)
            for name in floor
        ]
        x, room = float(MARGIN), WIDTH - 2 * MARGIN - GAP * (len(floor) - 1)
        for name, share in zip(floor, shares, strict=True):
            width = round(room * share / sum(shares), 1)
            parts.append(box(name, round(x, 1), y, width))
            x += width + GAP
        y += ROW + GAP
    for i, (colour, text) in enumerate(COLOURS.items()):
        x = MARGIN + 200 * i
        parts.append(
            f'<rect x="{x}" y="{y}" width="14" height="14" fill="{colour}" stroke="#888"/>'
        )
        parts.append(f'<text x="{x + 20}" y="{y + 12}">{text}</text>')
    parts += [
        mark(MARGIN + 10, y + 32, "1", EPISODE),
        mark(MARGIN + 410, y + 32, "a", ACTION),
    ]
    parts.append(
        f'<text x="{MARGIN + 26}" y="{y + 36}">an episode, from command to verdict</text>'
    )
    parts.append(
        f'<text x="{MARGIN + 426}" y="{y + 36}">an action, from policy to MuJoCo and back</text>'
    )
    size = f'width="{WIDTH}" height="{y + LEGEND:g}" viewBox="0 0 {WIDTH} {y + LEGEND:g}"'
    style = 'font-family="Helvetica, Arial, sans-serif" font-size="12.5" fill="#111"'
    background = '<rect width="100%" height="100%" fill="white"/>'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" {size} {style}>\n{background}\n'
        + "\n".join(parts)
        + "\n</svg>\n"
    )


if __name__ == "__main__":
    SVG.write_text(drawing())

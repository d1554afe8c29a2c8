"""Maps of two disturbances at once, as the report's page shows them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from armctl.report.style import Styles
from armctl.study.grid_tables import LEGEND, NO_LEADER, GridMap, grid_summary
from armctl.verdict.tables import UNKNOWN


@dataclass(frozen=True)
class Lead:
    """A cell of a map of leaders."""

    text: str
    title: str
    """Text that appears when the pointer rests on it."""
    colour: str | None = None
    """Colour of the leader; None if there is none."""
    certain: bool = False


def pair_maps(maps: Sequence[GridMap], units: Mapping[str, str], styles: Styles) -> dict[str, Any]:
    """Return everything on the page about pairs of disturbances."""
    several = any(len(grid_map.policies) > 1 for grid_map in maps)
    return {
        "maps": [_map(grid_map, units, styles) for grid_map in maps],
        "pairs_legend": LEGEND if several else "",
        "pairs_summary": grid_summary(maps),
    }


def _map(grid_map: GridMap, units: Mapping[str, str], styles: Styles) -> dict[str, Any]:
    grid, start = grid_map.grid, grid_map.start
    levels = [f"{level:g}" for level in grid_map.row_levels]
    undisturbed = [f"{styles[name].label} {grid_map.text(name, 0, 0)}" for name in grid_map.policies]
    leads = [
        [_lead(grid_map, i, j, styles) for j in range(start, len(grid.column_levels))]
        for i in range(start, len(grid.row_levels))
    ]
    return {
        "name": grid.name,
        "quantity": "Success, %" if grid_map.by_success else "Return",
        "row_unit": f"{grid.rows} ({units[grid.rows]})",
        "column_unit": f"{grid.columns} ({units[grid.columns]})",
        "undisturbed": ", ".join(undisturbed) if start else "",
        "rows": grid.rows,
        "columns": [f"{grid.columns} {level:g}" for level in grid_map.column_levels],
        "policies": [
            {"label": styles[name].label, "rows": list(zip(levels, _values(grid_map, name), strict=True))}
            for name in grid_map.policies
        ],
        "leads": list(zip(levels, leads, strict=True))
        if any(lead.text != UNKNOWN for row in leads for lead in row)
        else [],
    }


def _values(grid_map: GridMap, name: str) -> list[list[float | str | None]]:
    """Return a policy's success in percent, which has a colour, or what is printed in its place."""
    values, texts = grid_map.values[name][grid_map.start :, grid_map.start :], grid_map.texts(name)
    return [
        [
            100 * float(values[i, j])
            if grid_map.by_success and _is_number(text) and np.isfinite(values[i, j])
            else text
            for j, text in enumerate(row)
        ]
        for i, row in enumerate(texts)
    ]


def _is_number(text: str) -> bool:
    return text.lstrip("-").replace(".", "", 1).isdigit()


def _lead(grid_map: GridMap, row: int, column: int, styles: Styles) -> Lead:
    leader = grid_map.leaders[row][column]
    if leader is None:
        return Lead(UNKNOWN, "not compared")
    if leader.ties:
        return Lead(NO_LEADER, f"the same: {', '.join((leader.policy, *leader.ties))}")
    others = f"not significantly worse: {', '.join(leader.not_worse)}" if leader.not_worse else "all others are worse"
    label = styles[leader.policy].label
    return Lead(grid_map.leader_text(row, column).replace(leader.policy, label), others, styles[leader.policy].colour,
                leader.certain)  # fmt: skip

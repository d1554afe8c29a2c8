"""Success under disturbances on each page in docs/experts: python docs/make_robustness.py.

The figures show the two tables of sweeps in docs/robustness.md, which `python benchmarks/tables.py sweep` makes anew.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from armctl.core.arrays import Array
from armctl.policies import agent_cards

FOLDER = Path(__file__).parent
TABLES = FOLDER / "robustness.md"
PAGES = {
    "ik": ("reach_ik", "reach_ik:prepared=false"),
    "mpc": (
        "reach_mpc", "reach_mpc:prepared=false", "bridge_mpc", "bridge_mpc:prepared=false",
    ),
    "path_following": (
        "reach_ompl", "reach_ompl:prepared=false", "bridge_ompl", "bridge_ompl:prepared=false",
    ),
    "jerk_limited": ("reach_ruckig",),
    "resolved_rate": ("reach_rate",),
    "impedance": ("reach_impedance",),
    "sampling": ("reach_mppi", "bridge_mppi"),
    "floors_bridge": ("bridge_orca",),
    "sensors_alone": ("bridge_lidar_ompl",),
}  # fmt: skip
"""The policies of each page's figure."""
COLOURS = ("#1f77b4", "#9ecae1", "#d1822b", "#2f7d5b")
BEST = "#bbbbbb"
"""Colour of the best expert in a cell."""
COLOUR_COUNT = 64


@dataclass(frozen=True)
class Sweep:
    """A sweep as it is published."""

    env: str
    policies: list[str]
    cells: list[str]
    success: Array
    """(policies, cells, 3) value and 95 % interval in %; NaN where a policy is spared."""

    def of(self, policies: Sequence[str]) -> "Sweep":
        """Return the part of these policies, without cells in which all of them are spared."""
        rows = [self.policies.index(name) for name in policies]
        played = np.isfinite(self.success[rows, :, 0]).any(axis=0)
        return Sweep(
            self.env,
            list(policies),
            [self.cells[i] for i in np.flatnonzero(played)],
            self.success[rows][:, played],
        )


def sweeps() -> list[Sweep]:
    """Return the sweeps of disturbances in docs/robustness.md."""
    blocks = re.findall(
        r"^<!-- (?:record of \S+ )?armctl sweep [^>]*--disturbance .*?^<!-- end -->",
        TABLES.read_text(), re.MULTILINE | re.DOTALL,
    )  # fmt: skip
    return [_sweep(block) for block in blocks]


def _sweep(block: str) -> Sweep:
    rows = [
        [cell.strip() for cell in line[1:-1].split("|")]
        for line in block.splitlines()
        if line.startswith("| ")
    ]
    half = len(rows) // 2
    values, intervals = rows[1:half], rows[half + 1 :]
    success = np.array(
        [
            [
                (_number(value), *map(_number, interval.split(" to ")))
                if interval
                else (np.nan,) * 3
                for value, interval in zip(*both, strict=True)
            ]
            for both in zip(
                (row[1:] for row in values),
                (row[1:] for row in intervals),
                strict=True,
            )
        ]
    )
    env = re.search(r"--env armctl/(\S+)", block)
    return Sweep(
        env[1] if env else "ArmReach-v0",
        [row[0].strip("`") for row in values],
        rows[0][1:],
        success,
    )


def _number(text: str) -> float:
    return float(text) if text.isdigit() else np.nan


def draw(page: str, published: list[Sweep]) -> None:
    """Draw a page's policies in all cells of their sweeps."""
    parts = [
        (sweep, [name for name in PAGES[page] if name in sweep.policies])
        for sweep in published
    ]
    parts = [(sweep, names) for sweep, names in parts if names]
    figure, panels = plt.subplots(
        len(parts), figsize=(8, 2.9 * len(parts)), dpi=150,
        layout="constrained", squeeze=False,
    )  # fmt: skip
    for axes, (sweep, names) in zip(panels[:, 0], parts, strict=True):
        experts = sweep.of(
            [name for name in sweep.policies if name not in agent_cards()]
        )
        best = dict(
            zip(experts.cells, np.nanmax(experts.success[..., 0], axis=0), strict=True)
        )  # fmt: skip
        part = sweep.of(names)
        place = np.arange(len(part.cells))
        axes.plot(
            place, [best[cell] for cell in part.cells], "_", color=BEST,
            markersize=26, label="best expert",
        )  # fmt: skip
        for i, (name, success) in enumerate(
            zip(names, part.success, strict=True)
        ):
            value, low, high = success.T
            axes.errorbar(
                place + 0.14 * (i - (len(names) - 1) / 2),
                value, (value - low, high - value), fmt="o", markersize=5,
                color=COLOURS[i], label=name,
            )  # fmt: skip
        axes.set_xticks(place, part.cells, rotation=40, ha="right")
        axes.set_title(sweep.env, fontsize="medium", loc="left")
        axes.set_ylim(-4, 104)
        axes.set_ylabel("success, %")
        axes.grid(axis="y", color="#e5e5e5")
        axes.spines[["top", "right"]].set_visible(False)
        axes.set_yticks(range(0, 101, 20))
        axes.legend(
            frameon=False, loc="lower right", bbox_to_anchor=(1, 0.99),
            ncols=3, fontsize="small",
        )  # fmt: skip
    picture = FOLDER / "experts" / f"{page}.png"
    figure.savefig(picture)
    plt.close(figure)
    with Image.open(picture) as image:
        image.convert("RGB").quantize(COLOUR_COUNT).save(picture, optimize=True)


if __name__ == "__main__":
    for page in PAGES:
        draw(page, sweeps())

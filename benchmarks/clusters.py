"""Costs of a cluster, the comparison length from which it pays, and its limit.

    python benchmarks/clusters.py measure [--episodes 200]      # writes benchmarks/clusters.json
    python benchmarks/clusters.py simulate [--episodes 50000]   # reads it, and writes docs/clusters.png

`measure` lets the same policies play in one process, in two, and on clusters of Ray and Dask, whose nodes are processes
of this machine; then it takes apart what a unit costs, which is a block of episodes. Run it on a machine that does
nothing else. `simulate` puts these costs into a model (benchmarks/cluster_model.py) of up to 1,000 workers, each with a
core, in a network of 1 Gbit/s. Throughput and efficiency there are without the start of the workers.
"""

import json
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Annotated, Any

import cluster_costs
import matplotlib.pyplot as plt
import numpy as np
import typer
from cluster_costs import LONG, SHORT
from cluster_model import Costs, Outcome, simulated
from numpy.typing import NDArray
from printing import progress, show, versioned_table
from rich.table import Table

from armctl.core.registration import bare_id
from armctl.rollout.parallel import ROUNDS
from armctl.runtime.provenance import machine

MEASURED = Path(__file__).with_suffix(".json")
PICTURE = Path(__file__).parents[1] / "docs" / "clusters.png"
WORKERS = (1, 3, 10, 30, 100, 300, 1000)
WORKERS_IN_TABLE = (10, 100, 1000)
"""Numbers of workers in the table."""
BLOCKS = (1, ROUNDS, 16, 64, 256)
ROUND_TRIP, BANDWIDTH = 0.5e-3, 125e6
"""s and bytes/s of the network of the simulated clusters."""
HOUR = 3600.0
"""s"""
LOSSES = (0.0, 0.01, 0.1, 1.0)
"""Shares of the workers that are lost in an hour."""
LOSING, LONGER = 300, 20
"""Workers of the comparison in which some are lost, and how many times as many episodes it has."""
COLOURS = {"Ray": "#1f77b4", "Dask": "#d1822b"}

app = typer.Typer(help=__doc__, add_completion=False, pretty_exceptions_enable=False)


@app.command()
def measure(
    episodes: int = 200,
    few: Annotated[int, typer.Option(help="Episodes on the bridge, which are long.")] = 20,
    out: Path = MEASURED,
) -> None:
    """Measure, print tables, and write what the simulation needs."""
    runs = cluster_costs.compared(episodes)
    engines = {"Ray": cluster_costs.of_ray(), "Dask": cluster_costs.of_dask()}
    measured = {
        "date": str(date.today()),
        "machine": machine(),
        "versions": cluster_costs.versions(),
        "runs": runs,
        "episode_s": {SHORT: cluster_costs.durations(SHORT, episodes), LONG: cluster_costs.durations(LONG, few)},
        "write_s": cluster_costs.writing(),
        "bytes": cluster_costs.sizes(),
        "engines": engines,
    }
    out.write_text(json.dumps(measured) + "\n")
    show(_runs_table(runs), _costs_table(engines, measured["write_s"]))


def _runs_table(runs: list[dict[str, Any]]) -> Table:
    table = versioned_table(
        "", "connects s", "first result s", "all s", "processor s", "episodes/s after the first", "pays from episodes"
    )
    single = runs[0]
    for run in runs:
        overhead = run["connect_s"] + run["first_s"] - single["first_s"]
        saved = 1 / _rate(single) - 1 / _rate(run)
        pays = "" if run is single else f"{overhead / saved:,.0f}" if saved > 0 else "never here"
        table.add_row(
            run["where"], *(f"{run[name]:.1f}" for name in ("connect_s", "first_s", "all_s", "processor_s")),
            f"{_rate(run):.1f}", pays,
        )  # fmt: skip
    return table


def _rate(run: dict[str, Any]) -> float:
    """Return the episodes per second after the first."""
    return (run["episodes"] - 1) / (run["all_s"] - run["first_s"])


def _costs_table(engines: dict[str, dict[str, Any]], write: float) -> Table:
    table = versioned_table("milliseconds of a block of no work", *engines)
    labels = {
        "send": "the client sends it", "schedule": "the scheduler", "transport": "on the way, there and back",
        "work": "its worker", "receive": "the client receives its result",
    }  # fmt: skip
    for name, words in labels.items():
        table.add_row(words, *(f"{1e3 * costs[name]:.2f}" for costs in engines.values()))
    table.add_row(
        "the client waits, for each 1,000 under way", *(f"{1e6 * costs['wait']:.2f}" for costs in engines.values())
    )
    table.add_row("the client writes an episode", *[f"{1e3 * write:.2f}"] * len(engines))
    return table


@app.command()
def simulate(episodes: int = 50_000, measured: Path = MEASURED, out: Path = PICTURE) -> None:
    """Simulate, print tables, and draw a picture."""
    measurements = json.loads(measured.read_text())
    settings = [
        (env, engine, block, workers) for env in (SHORT, LONG) for engine in measurements["engines"] for block in BLOCKS
        for workers in WORKERS
    ]  # fmt: skip
    rates = {
        (env, engine, block, workers): _steady(measurements, env, engine, block, workers, episodes)
        for env, engine, block, workers in progress(settings)
    }
    losses = _losses_table(measurements, LONGER * episodes)
    show(_checks_table(measurements), _rates_table(measurements, rates), losses)
    _draw(measurements, rates, out)


def costs_of(measurements: dict[str, Any], engine: str, block: int, network: bool = True) -> Costs:
    """Return what such an engine costs, with blocks of so many episodes, in a network or on one machine."""
    costs = Costs(**measurements["engines"][engine], start=_start(measurements, engine), write=measurements["write_s"])
    sent = measurements["bytes"]["unit"] + measurements["bytes"]["result"] * block / ROUNDS
    return replace(costs, transport=costs.transport + ROUND_TRIP + sent / BANDWIDTH) if network else costs


def _start(measurements: dict[str, Any], engine: str) -> float:
    """Return the seconds to the first result on two workers, less what one process needs for that."""
    single = measurements["runs"][0]
    two = next(run for run in measurements["runs"] if run["where"].startswith(engine) and run["workers"] == 2)
    return max(0.0, two["first_s"] - single["first_s"])


def _durations(measurements: dict[str, Any], env: str, block: int, episodes: int) -> NDArray[np.float64]:
    """Return the seconds of the blocks of so many episodes in all, drawn from those of each policy in turn."""
    rng = np.random.default_rng(0)
    policies = measurements["episode_s"][env].values()
    units = max(1, round(episodes / len(policies) / block))
    return np.concatenate([rng.choice(measured, (units, block)).sum(axis=1) for measured in policies])


def _steady(measurements: dict[str, Any], env: str, engine: str, block: int, workers: int, episodes: int) -> float:
    """Return the episodes per second, without the start."""
    durations, costs = _durations(measurements, env, block, episodes), costs_of(measurements, engine, block)
    outcome = simulated(durations, block, workers, replace(costs, start=0.0))
    return len(outcome.results) * block / outcome.seconds


def _checks_table(measurements: dict[str, Any]) -> Table:
    """Simulate what was measured here."""
    table, single = versioned_table("on this machine", "measured s", "simulated s"), measurements["runs"][0]
    for run in measurements["runs"]:
        engine = run["where"].partition(",")[0]
        if engine not in measurements["engines"]:
            continue
        durations, costs = (
            _durations(measurements, SHORT, ROUNDS, run["episodes"]),
            costs_of(measurements, engine, ROUNDS, False),
        )
        seconds = single["first_s"] + simulated(durations, ROUNDS, run["workers"], costs).seconds
        table.add_row(run["where"], f"{run['all_s']:.1f}", f"{seconds:.1f}")
    return table


def _rates_table(measurements: dict[str, Any], rates: dict[tuple[str, str, int, int], float]) -> Table:
    table = versioned_table(
        "", "engine", "episodes a block", "client and scheduler keep up with workers",
        *(f"episodes/s of {workers:,}" for workers in WORKERS_IN_TABLE), f"of ideal, {WORKERS_IN_TABLE[-1]:,}",
        f"limit of {WORKERS_IN_TABLE[-1]:,} by the closed form",
    )  # fmt: skip
    for env in (SHORT, LONG):
        episode_s = float(np.mean([np.mean(measured) for measured in measurements["episode_s"][env].values()]))
        for engine in measurements["engines"]:
            for block in BLOCKS:
                costs, by_workers = (
                    costs_of(measurements, engine, block),
                    [rates[env, engine, block, workers] for workers in WORKERS_IN_TABLE],
                )
                highest = block * min(costs.limit(block), WORKERS_IN_TABLE[-1] / (block * episode_s + costs.work))
                table.add_row(
                    f"`{bare_id(env)}`, {episode_s:.2g} s an episode", engine, str(block),
                    f"{costs.saturated_by(block * episode_s, block):,}", *(f"{rate:,.0f}" for rate in by_workers),
                    f"{by_workers[-1] * episode_s / WORKERS_IN_TABLE[-1]:.0%}", f"{highest:,.0f}",
                )  # fmt: skip
    return table


def _losses_table(measurements: dict[str, Any], episodes: int) -> Table:
    """Return the costs of lost workers that are not replaced."""
    table = versioned_table(
        f"of {LOSING} workers lost an hour, {episodes:,} episodes on the bridge", "lost in all", "minutes",
        "blocks played again", "worker minutes wasted", "results",
    )  # fmt: skip
    durations, costs = _durations(measurements, LONG, ROUNDS, episodes), costs_of(measurements, "Dask", ROUNDS)
    for share in LOSSES:
        outcome: Outcome = simulated(durations, ROUNDS, LOSING, costs, losses=share / HOUR)
        table.add_row(
            f"{share:.0%}", str(outcome.lost), f"{outcome.seconds / 60:.1f}", str(outcome.again),
            f"{outcome.wasted / 60:.1f}", f"{len(outcome.results) / len(durations):.0%}",
        )  # fmt: skip
    return table


def _draw(measurements: dict[str, Any], rates: dict[tuple[str, str, int, int], float], out: Path) -> None:
    """Draw episodes per second against workers, in a panel for each environment."""
    figure, panels = plt.subplots(1, 2, figsize=(9, 4), dpi=150, layout="constrained")
    for env, axes in zip((SHORT, LONG), panels, strict=True):
        episode_s = float(np.mean([np.mean(measured) for measured in measurements["episode_s"][env].values()]))
        axes.plot(WORKERS, np.array(WORKERS) / episode_s, color="black", linewidth=0.8, linestyle=":", label="ideal")
        for engine in measurements["engines"]:
            for block, style in ((ROUNDS, "o-"), (64, "s--")):
                line = [rates[env, engine, block, workers] for workers in WORKERS]
                axes.plot(
                    WORKERS, line, style, color=COLOURS[engine], markersize=3.5, linewidth=1.3,
                    label=f"{engine}, blocks of {block}",
                )  # fmt: skip
        title = f"{bare_id(env)}, {episode_s:.2g} s an episode"
        axes.set(xscale="log", yscale="log", xlabel="workers", ylabel="episodes per second", title=title)
        axes.grid(alpha=0.25, linewidth=0.5)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].legend(frameon=False, fontsize=9)
    figure.savefig(out)


if __name__ == "__main__":
    app()

"""Draws a new sealed test, and lets all published policies play it, once: what a maintainer runs for a release.

    python tools/release.py draw                     # a fresh seed, and the layouts of its episodes
    python tools/release.py play                     # hours: with all that have not played it yet
    python tools/release.py play bridge_ppo          # only with this one, and the other trainings of its recipe
    python tools/release.py play --again "reach_ik copes with noise now"

The test before becomes one of the development seeds. `plays.csv` has a row for each play of a sealed test; agents'
cards get their evaluations from it. A policy plays a test once. It may play again if its episodes are others by
`benchmarks/golden.json`, which is recorded anew whenever they change on purpose, and then the row says why. After an
interrupt, the same command goes on. Then make the published tables: `python benchmarks/tables.py --stale`.
"""

import csv
import functools
import hashlib
import json
import os
import re
import secrets
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer
import zoo
from make_layout_pool import with_seeds

import armctl
from armctl.agents import Evaluation, read_card
from armctl.core import seeds
from armctl.core.files import write_atomically
from armctl.core.registration import environment_names
from armctl.policies import agent_cards
from armctl.study.line_up import line_up
from armctl.study.reproduce import evaluation_of, reproduce
from armctl.tasks.reach.layout_pool import POOL_FILE, read_pool, write_pool

ROOT = Path(__file__).parents[1]
PLAYS, SEEDS, GOLDEN = ROOT / "tools" / "plays.csv", Path(seeds.__file__), ROOT / "benchmarks" / "golden.json"
COLUMNS = (
    "date", "seed", "policy", "env", "sha256", "code", "again", "episodes", "success", "low", "high", "mean_return",
    "mean_steps", "digest",
)  # fmt: skip
"""`sha256` is a network's. `code` is a checksum of the environment's episodes in `GOLDEN`; `again` is why a policy has
played a test a second time."""
EPISODES = 500
"""Number of episodes of policies without a card."""
SMALLEST_SEED = 10**6
"""Smallest seed of a drawn test: smaller ones are what people choose in development."""

app = typer.Typer(pretty_exceptions_enable=False)


@dataclass(frozen=True)
class Published:
    """A policy that a release plays the test with, in an environment."""

    name: str
    env: str
    card: Path | None = None
    """Card of a learned agent."""

    @property
    def identity(self) -> tuple[str, str]:
        """Identity of what has played: a network, or else the policy; and the environment."""
        return read_card(self.card).sha256 if self.card else self.name, self.env

    @property
    def code(self) -> str:
        """A checksum of what its episodes depend on, besides the network."""
        return checksum_of_episodes(self.env)

    def play(self, seed: int) -> Evaluation:
        """Let it play the test's episodes. A card gets the results, and keeps those of development."""
        if self.card is None:
            episodes = armctl.evaluate(
                self.name, self.env, episodes=EPISODES, seed=seed, worlds=50, lower_bound_steps=False
            )
            return evaluation_of(episodes, seed)
        again = reproduce(self.card, seed=seed)
        changes: dict[str, Any] = {"evaluation": again.measured}
        if again.card.development is None and again.claimed.seed != seed:
            changes["development"] = again.claimed
        write_atomically(self.card, again.card.model_copy(update=changes).model_dump_json(indent=2) + "\n")
        return again.measured


def published() -> Iterator[Published]:
    """Return all agents with a card, and all other policies that a suite lets play in armctl's own environments."""
    for card in sorted((zoo.HOME / "agents").rglob("*.json")):
        yield Published(card.stem, read_card(card).env, card)
    for env in environment_names():
        if not env.startswith("armctl/"):  # of an installed package, or one that the user has registered
            continue
        for policy in line_up(env):
            if policy not in agent_cards():
                yield Published(policy, env)


@functools.cache
def checksum_of_episodes(env: str) -> str:
    """Return a checksum of the recorded episodes of an environment with its default options."""
    runs = {name: run for name, run in json.loads(GOLDEN.read_text()).items() if name.startswith(f"{env} {{}} ")}
    ends = {name: [run.get("outcomes"), run.get("lengths")] for name, run in sorted(runs.items())}
    return hashlib.sha256(json.dumps(ends).encode()).hexdigest()[:12]


def plays(seed: int) -> dict[tuple[str, str], dict[str, str]]:
    """Return the last row of each policy that has played the test of a seed."""
    rows = list(csv.DictReader(PLAYS.open(newline=""))) if PLAYS.exists() else []
    return {(row["sha256"] or row["policy"], row["env"]): row for row in rows if row["seed"] == str(seed)}


def note(policy: Published, seed: int, again: str, result: Evaluation) -> None:
    """Write down that a policy has played."""
    new = not PLAYS.exists()
    low, high = result.success_interval
    row = {
        "date": datetime.now(UTC).date().isoformat(), "seed": seed, "policy": policy.name, "env": policy.env,
        "sha256": read_card(policy.card).sha256 if policy.card else "", "code": policy.code, "again": again,
        "episodes": result.episodes, "success": result.success_rate, "low": round(low, 4), "high": round(high, 4),
        "mean_return": result.mean_return, "mean_steps": result.mean_steps, "digest": result.digest,
    }  # fmt: skip
    with PLAYS.open("a", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        if new:
            writer.writeheader()
        writer.writerow(row)


@app.command()
def draw(
    force: Annotated[bool, typer.Option("--force", help="Even if not all have played the present test.")] = False,
    processes: Annotated[int, typer.Option(min=1, help="For the layouts.")] = os.cpu_count() or 1,
) -> None:
    """Draw the seed of a new sealed test, and the layouts among obstacles of its episodes."""
    rows = plays(seeds.TEST_SEED)
    missing = [f"{policy.name} in {policy.env}" for policy in published() if policy.identity not in rows]
    if missing and not force:
        raise SystemExit(
            f"{len(missing)} published policies have not played the test of seed {seeds.TEST_SEED}, whose tables would "
            f"stay incomplete: {', '.join(missing[:3])} ... Run play first, or draw --force."
        )
    seed = SMALLEST_SEED + secrets.randbelow(seeds.VALIDATION_SEED - SMALLEST_SEED)
    pool = with_seeds(read_pool(POOL_FILE), [seeds.DEVELOPMENT_SEED, seed], processes)
    text, count = re.subn(r"^TEST_SEED = \d+$", f"TEST_SEED = {seed}", SEEDS.read_text(), flags=re.MULTILINE)
    assert count == 1
    write_atomically(POOL_FILE, lambda path: write_pool(pool, path))
    write_atomically(SEEDS, text)
    print(f"The sealed test is seed {seed} now; {seeds.TEST_SEED} is for development. Nobody has played it: run play.")


@app.command()
def play(
    names: Annotated[list[str] | None, typer.Argument(metavar="[POLICY]...", show_default="all")] = None,
    again: Annotated[str, typer.Option("--again", metavar="WHY", help="Also with those whose episodes changed.")] = "",
) -> None:
    """Let published policies that have not played the sealed test play it, once."""
    seed, chosen = seeds.TEST_SEED, list(published())
    if unknown := set(names or ()) - {policy.name for policy in chosen}:
        raise SystemExit(f"{', '.join(sorted(unknown))}: not published")
    if names:
        chosen = [policy for policy in chosen if policy.name in names or policy.name.rpartition("-")[0] in names]
    rows = plays(seed)
    waiting = [policy for policy in chosen if policy.identity not in rows]
    done = [policy for policy in chosen if policy.identity in rows]
    changed = [policy for policy in done if rows[policy.identity]["code"] != policy.code]
    if changed and not again:
        raise SystemExit(
            f"The episodes of {changed[0].env} are others than when {changed[0].name} played this test: a second play "
            "needs --again WHY, which plays.csv gets"
        )
    if names and not waiting and not changed:
        raise SystemExit(f"{', '.join(names)}: played the test of seed {seed} already. A policy plays it once.")
    for i, policy in enumerate([*waiting, *changed], start=1):
        result = policy.play(seed)
        note(policy, seed, again if policy in changed else "", result)
        print(f"{i}/{len(waiting) + len(changed)} {policy.name}, {policy.env}: {result.success_rate:.1%}", flush=True)
    zoo.write()


if __name__ == "__main__":
    app()

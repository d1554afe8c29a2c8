"""Results as an attacker would write them: whole, with right checksums, and with content of his choice."""

import contextlib
import json
import sqlite3
from dataclasses import replace

from armctl.core.files import digest, sealed, unsealed
from armctl.core.registration import bare_id
from armctl.episodes.store import STORE, EpisodeStore, read_store


def rewrite(folder, identity, facts, results, runs=()):
    """Replace all that a comparison's store says."""
    with EpisodeStore(folder, identity, 2**62, overwrite=True) as store:
        for result in results:
            store.write(result)
        store.finish(facts, runs)


def forge(folder, there, hostile):
    """Replace a text in all that a comparison's store says."""
    stored = read_store(folder)
    identity, facts = (
        json.loads(json.dumps(values).replace(json.dumps(there)[1:-1], json.dumps(hostile)[1:-1]))
        for values in (stored.identity, stored.facts)
    )
    results = [
        replace(
            one,
            policy=hostile if one.policy == there else one.policy,
            env=bare_id(hostile) if one.env == there else one.env,
        )
        for one in stored.episodes
    ]
    rewrite(folder, identity, facts, results, stored.runs)


def change_facts(folder, change):
    """Change what a comparison's store says besides the episodes."""
    with contextlib.closing(sqlite3.connect(folder / STORE)) as file, file:
        ((text,),) = file.execute("SELECT facts FROM cell")
        facts = unsealed(text)
        change(facts)
        file.execute("UPDATE cell SET facts = ?", (sealed(facts),))


def write_sweep(folder, table):
    """Write a sweep's table as CSV text."""
    (folder / "sweep.csv").write_text(table)
    (folder / "sweep.json").write_text(sealed({"sweep.csv": digest(table)}))

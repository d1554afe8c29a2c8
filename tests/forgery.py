"""Results as an attacker would write them: whole, with right checksums, and with content of his choice."""

import contextlib
import json
import sqlite3
from dataclasses import replace

from armctl.core.files import sealed, unsealed
from armctl.core.registration import bare_id
from armctl.episodes.store import Store
from armctl.episodes.stored import STORE, UNDISTURBED, StoredCell, read_store
from armctl.episodes.table import EpisodeTable


def rewrite(folder, identity, facts, results, runs=()):
    """Replace all that a comparison's store says."""
    record = read_store(folder).record
    record["envs"], record["tasks"] = [identity["env"]], {identity["env"]: next(iter(record["tasks"].values()))}
    _rewrite(folder, {UNDISTURBED: StoredCell(identity, facts, runs, results)}, record)


def _rewrite(folder, cells, record=None):
    record = record or read_store(folder).record
    with Store(folder, overwrite=True) as store:
        for name, cell in cells.items():
            store.open(cell.identity["seed"], cells)
            writer = store.cell(name, cell.identity, 2**62)
            for result in cell.episodes:
                writer.write(result)
            writer.finish(cell.facts, cell.runs)
        store.describe(record)


def forge(folder, there, hostile):
    """Replace a text in all that a store says of its cells."""
    stored = read_store(folder)
    cells = {name: _forged(cell, there, hostile) for name, cell in stored.cells.items()}
    _rewrite(folder, cells, _with_text(stored.record, there, hostile))


def _with_text(values, there, hostile):
    return json.loads(json.dumps(values).replace(json.dumps(there)[1:-1], json.dumps(hostile)[1:-1]))


def _forged(stored, there, hostile):
    identity, facts = (_with_text(values, there, hostile) for values in (stored.identity, stored.facts))
    results = [
        replace(
            one,
            policy=hostile if one.policy == there else one.policy,
            env=bare_id(hostile) if one.env == there else one.env,
        )
        for one in stored.episodes
    ]
    return StoredCell(identity, facts, stored.runs, EpisodeTable(results))


def change_facts(folder, change):
    """Change what a comparison's store says besides the episodes."""
    _change(folder, "cell", "facts", change)


def change_record(folder, change):
    """Change what a store says of the study besides its cells."""
    _change(folder, "study", "record", change)


def _change(folder, table, column, change):
    with contextlib.closing(sqlite3.connect(folder / STORE)) as file, file:
        ((text,),) = file.execute(f"SELECT {column} FROM {table}")
        values = unsealed(text)
        change(values)
        file.execute(f"UPDATE {table} SET {column} = ?", (sealed(values),))

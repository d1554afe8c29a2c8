"""Results as an attacker would write them: whole, with right checksums, and with content of his choice."""

import json
from dataclasses import replace

from armctl.core.files import digest, sealed, unsealed
from armctl.core.registration import bare_id
from armctl.episodes.store import EpisodeLog, read_episodes


def forge(folder, there, hostile):
    """Replace a text in all that a comparison's folder says."""
    own, summary = (unsealed((folder / name).read_text()) for name in ("comparison.json", "summary.json"))
    episodes = read_episodes(folder, own)
    own, summary = (
        json.loads(json.dumps(values).replace(json.dumps(there)[1:-1], json.dumps(hostile)[1:-1]))
        for values in (own, summary)
    )
    results = [
        replace(
            one,
            policy=hostile if one.policy == there else one.policy,
            env=bare_id(hostile) if one.env == there else one.env,
        )
        for one in episodes
    ]
    with EpisodeLog(folder, own, len(results) + 1, overwrite=True) as log:
        log.finish(results, summary)


def write_sweep(folder, table):
    """Write a sweep's table as CSV text."""
    (folder / "sweep.csv").write_text(table)
    (folder / "sweep.json").write_text(sealed({"sweep.csv": digest(table)}))

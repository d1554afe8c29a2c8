"""Options of verbs that compare: what stands between a policy and its worlds."""

from typing import Annotated

import typer

Isolate = Annotated[
    bool,
    typer.Option(
        "--isolate",
        help="Play each policy in a process of its own, which gets observations only: no world, no seed. Policies "
        "that see the true state cannot be isolated.",
    ),
]
Timeout = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        help="Time that a policy in another process may take for an answer.",
        show_default="10; of an isolated policy, 300",
    ),
]
Filter = Annotated[
    bool,
    typer.Option(
        "--filter",
        help='Play each policy behind the safety filter; for one alone, `"filtered(reach_ppo):margin=0.02"`.',
    ),
]

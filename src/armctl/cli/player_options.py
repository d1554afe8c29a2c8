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
        help="Time that a decision of a policy, or a step of the environment, may take.",
        show_default="10 in another Python; of an isolated policy, 300; else any",
    ),
]
Filter = Annotated[
    bool,
    typer.Option(
        "--filter",
        help='Play each policy behind the safety filter; for one alone, `"filtered(reach_ppo):margin=0.02"`.',
    ),
]

"""Purposes of seeds, so that nothing is judged on episodes that it was made with.

| seeds | episodes |
|---|---|
| 0, 1, ... | development: whatever is tuned, is tuned on these |
| `DEVELOPMENT_SEED` | of these, the one by which a training judges its agent, and the trainings to publish are chosen |
| `TEST_SEED` | sealed: published figures only. A release draws it, and plays all published policies on it, once |
| from `VALIDATION_SEED` on | held-out episodes that select the best agent of a training |
| from `TRAINING_SEEDS` on | training; training seed k begins at (k + 1) * `TRAINING_SEEDS` |

No two of them share an episode (see `armctl.disturbances.episode_entropy`).
"""

TEST_SEED = 3381427
DEVELOPMENT_SEED = 2026
VALIDATION_SEED = 10**8
TRAINING_SEEDS = 10**9

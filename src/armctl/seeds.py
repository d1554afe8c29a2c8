"""Which seeds are for what, so that nobody is judged on episodes that it was made with.

| seeds | episodes |
|---|---|
| 0, 1, ... | development: whatever is tuned, is tuned on these |
| `TEST_SEED` | sealed: published tables and the evaluation on an agent's card; nothing is tuned on it |
| from `VALIDATION_SEED` on | held-out episodes that select the best agent of a training |
| from `TRAINING_SEEDS` on | training; training seed k begins at (k + 1) * `TRAINING_SEEDS` |

No two of them share an episode (see `armctl.disturbances.episode_entropy`).
"""

TEST_SEED = 2026
VALIDATION_SEED = 10**8
TRAINING_SEEDS = 10**9

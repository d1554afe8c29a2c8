"""Makes policies for worlds, in this process or in another one, and takes the time that it needs."""

from typing import Any

from armctl.core.errors import Disqualified
from armctl.envs import EpisodeVectorEnv
from armctl.episodes.failures import PolicyDisqualified
from armctl.policies import Policy, make_policy
from armctl.remote.names import is_remote
from armctl.rollout.decision_times import timed_construction
from armctl.runtime.isolation import isolated
from armctl.runtime.state_guard import StateGuard


def build_policy(policy: Any, env: EpisodeVectorEnv, name: str, policy_seed: int) -> Policy:
    """Make a policy called `name` for the worlds of `env`, which were never reset: there is no episode to observe.

    Raises what `make_policy` raises, and `PolicyDisqualified` if making it writes to the world.
    """
    return build_timed(policy, env, name, policy_seed)[0]


def build_timed(
    policy: Any,
    env: EpisodeVectorEnv,
    name: str,
    policy_seed: int,
    isolate: bool = False,
    timeout: float | None = None,
) -> tuple[Policy, float]:
    """Do the same, and return also the time that took (see `timed_construction`).

    With `isolate`, the policy is made in a process of its own, if it can be (see `armctl.runtime.isolation`). `timeout`
    (s) is for the answers of a policy in another process.
    """
    if isolate and (apart := isolated(policy, env, name, policy_seed)) is not None:
        apart.patience = timeout or apart.patience
        return apart, apart.construction_ms
    guard = StateGuard(env)
    try:
        with guard.assert_unchanged(new_episode=True):
            new_policy, construction_ms = timed_construction(
                lambda: make_policy(policy, env, name=name, policy_seed=policy_seed)
            )
            guard.has_access = new_policy.sees == "state"
        if is_remote(policy) and timeout:
            new_policy.patience = timeout  # type: ignore[attr-defined]
        return new_policy, construction_ms
    except Disqualified as error:
        raise PolicyDisqualified(f"{name} is disqualified: when it was made, {error}") from error

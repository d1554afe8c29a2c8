"""Demonstrations by an engine's workers: blocks of episodes, which come back whole."""

from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from armctl.datasets.demonstrations import Demonstration, demonstrate
from armctl.envs import EpisodeVectorEnv, make_worlds
from armctl.episodes.failures import PolicyFailed
from armctl.episodes.record import EpisodeResult
from armctl.policies import Policy, PolicyFactory
from armctl.rollout.parallel import RolloutBatch, Setting, WorkerConfig, batch, do_in_workers
from armctl.runtime.engines import Engine

RecordedEpisode = tuple[EpisodeResult, Demonstration]


class WorldsAsAsked:
    """Worlds with the interface that was asked for, whoever plays in them: it is what is recorded."""

    def __init__(self, env: str, worlds: int, options: Mapping[str, Any], threads: int = 0) -> None:
        self.requested = make_worlds(env, worlds, options, threads)

    def of(self, _: Any) -> EpisodeVectorEnv:
        """These worlds, whatever the policy."""
        return self.requested

    def close(self) -> None:
        """Close them."""
        self.requested.close()


def demonstrate_in_workers(
    policy: str | Path | PolicyFactory,
    actor: Policy,
    interfaces: WorldsAsAsked,
    config: WorkerConfig,
    name: str,
    episodes: Sequence[int],
    engine: Engine,
) -> Generator[RecordedEpisode, None, None]:
    """Yield what `demonstrate` yields, of a policy that is built here, as `actor`, in the worlds of `interfaces`.

    Raises `PolicyFailed` when all that was begun has ended, and `WorkersFailed`.
    """
    failure: PolicyFailed | None = None
    setting = Setting(config, {name: policy})
    with closing(do_in_workers(_play, setting, {name: actor}, interfaces, {name: episodes}, engine)) as everything:
        for block in everything:
            yield from block.results
            if block.failure:
                failure = PolicyFailed(block.failure)
                failure.add_note(block.traceback)
    if failure is not None:
        raise failure


def _play(setting: Setting, name: str, episodes: Sequence[int]) -> RolloutBatch:
    seed = setting.config.seed
    return batch(setting, name, lambda timed, worlds: demonstrate(timed.policy, worlds, episodes, seed, name))

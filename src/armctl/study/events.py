"""Events of a cell besides its episodes, while it is played: failures, interrupts, returns beyond their bounds."""

from dataclasses import dataclass, field

from armctl.core.errors import ConfigurationError
from armctl.envs import ERROR, RETURN_BOUNDS
from armctl.episodes.record import EpisodeResult, FailedEpisode
from armctl.episodes.table import EpisodeTable
from armctl.rollout.parallel import RolloutBatch
from armctl.stats.intervals import Bounds


@dataclass
class Events:
    """Failures, crashes and other events of a cell besides its episodes."""

    failures: dict[str, str] = field(default_factory=dict)
    tracebacks: dict[str, str] = field(default_factory=dict)
    disqualified: list[str] = field(default_factory=list)
    crashes: dict[str, FailedEpisode] = field(default_factory=dict)
    """The first episode in which each policy failed."""
    construction_ms: dict[str, float] = field(default_factory=dict)
    interrupted: bool = False
    decided_after: int | None = None
    """Number of episodes of each policy that decided the comparison; None if all are played."""
    remarks: dict[str, None] = field(default_factory=dict)
    """Remarks on what the environment returned."""

    def note(self, batch: RolloutBatch) -> None:
        """Keep what a batch tells."""
        self.remarks |= dict.fromkeys(batch.remarks)
        if batch.failure:
            self.failures[batch.policy] = batch.failure
            self.tracebacks[batch.policy] = batch.traceback
        if batch.disqualified:
            self.disqualified.append(batch.policy)
        for crash in (result for result in batch.results if isinstance(result, FailedEpisode)):
            first = self.crashes.setdefault(crash.policy, crash)
            self.crashes[crash.policy] = min(first, crash, key=lambda crash: crash.episode)

    def note_crashes(self, results: EpisodeTable) -> None:
        """Say in how many episodes each policy failed, and why in the first that was played now."""
        for name, batch in results.by_policy().items():
            episodes = batch.column("episode")[batch.column("outcome") == ERROR]
            if not len(episodes):
                continue
            crash = self.crashes.get(name)
            first = f"the first is episode {episodes.min()}"
            if crash is not None:
                first = f"episode {crash.episode}: {crash.message}"
                self.tracebacks.setdefault(name, crash.traceback)
            message = (
                f"{name} raised an error, or returned an invalid action, in {len(episodes)} of {len(batch)} episodes, "
                f"which count as failures; {first}"
            )
            self.failures[name] = "; ".join(filter(None, (self.failures.get(name), message)))


def check_return(result: EpisodeResult, bounds: Bounds | None) -> None:
    """Raise `ConfigurationError` for a return beyond the stated bounds, by more than what sums are rounded by."""
    if bounds is None or result.outcome == ERROR:
        return
    rounding = 1e-9 * max(map(abs, bounds))
    if not bounds[0] - rounding <= result.total_reward <= bounds[1] + rounding:
        raise ConfigurationError(
            f"episode {result.episode} of {result.policy} has the return {result.total_reward:g}, outside the stated "
            f"{RETURN_BOUNDS} [{bounds[0]:g}, {bounds[1]:g}], which no episode may exceed: correct them"
        )

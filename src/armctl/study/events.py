"""What happens while a cell is played, besides its episodes."""

from dataclasses import dataclass, field

from armctl.envs import ERROR
from armctl.episodes.record import FailedEpisode
from armctl.episodes.table import EpisodeTable
from armctl.rollout.parallel import RolloutBatch


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

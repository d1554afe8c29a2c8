"""Failures of policies: an episode in which a policy fails is a loss, and a policy that cannot play is refused."""

from collections.abc import Iterable, Iterator, Sequence

from armctl.core.errors import ArmctlError
from armctl.episodes.record import EpisodeResult, FailedEpisode

TRIES = 3
"""A policy that fails at once in so many episodes, the first that it plays, cannot play at all."""


class PolicyFailed(ArmctlError):
    """A policy raised an error, or returned an invalid action."""


class PolicyDisqualified(PolicyFailed):
    """A policy wrote to the world. None of its episodes count."""


class FirstEpisodes:
    """Tells a policy that cannot play at all from one that fails in some episodes.

    It cannot if it fails in all of the first `TRIES` of these `episodes` before it has acted. Until that is known,
    episodes in which it fails at once are held back.
    """

    def __init__(self, name: str, episodes: Sequence[int]) -> None:
        self._name, self._undecided = name, set(episodes[:TRIES])
        self._held: list[FailedEpisode] = []
        self._unplayable = False

    def counted(self, result: EpisodeResult) -> list[EpisodeResult]:
        """Return the results that count by now, of those since the last call. Raises `PolicyFailed` if it cannot."""
        if self._unplayable:
            return []
        if not self._undecided:
            return [result]
        if not (isinstance(result, FailedEpisode) and result.length == 0):
            if result.episode not in self._undecided:
                return [result]
            self._undecided.clear()
            return [*self._held, result]
        self._held.append(result)
        self._undecided.discard(result.episode)
        if self._undecided:
            return []
        self._unplayable = True
        raise failure_of(min(self._held, key=lambda result: result.episode))


def until_unplayable(results: Iterable[EpisodeResult], name: str, episodes: Sequence[int]) -> Iterator[EpisodeResult]:
    """Yield results of `episodes`. Raises `PolicyFailed` if the policy cannot play at all (see `FirstEpisodes`)."""
    first = FirstEpisodes(name, episodes)
    for result in results:
        yield from first.counted(result)


def unless_failed(results: Iterable[EpisodeResult]) -> Iterator[EpisodeResult]:
    """Yield results, where episodes that fail are of no use. Raises `PolicyFailed` for the first one."""
    for result in results:
        if isinstance(result, FailedEpisode):
            raise failure_of(result)
        yield result


def failure_of(result: FailedEpisode) -> PolicyFailed:
    """Return the error of a failed episode."""
    failure = PolicyFailed(f"{result.policy} failed in episode {result.episode}: {result.message}")
    failure.add_note(result.traceback)
    return failure

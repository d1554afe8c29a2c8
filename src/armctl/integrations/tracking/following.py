"""Hands a training's evaluations and agent to trackers, each in a thread of its own.

So a tracker that hangs or fails costs a training nothing. What a tracker has been given is noted in the training's
folder: a resumed training continues its run, and catches up on what is missing there.
"""

import contextlib
import json
import math
import queue
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from armctl.agents import CARD, GRAPH, read_card
from armctl.core.errors import FAILURES, ConfigurationError, ResultsError, described
from armctl.core.files import FORMAT, bounded_text, inside, sealed, unsealed, write_atomically
from armctl.integrations.tracking.film import film_agent
from armctl.integrations.tracking.tracker import Ending, Tracker, load_tracker
from armctl.study.curves import CURVE, read_curve
from armctl.training.learners import Recipe
from armctl.training.run import SETTINGS

FOLDER = "tracking"
"""Folder within a training's folder: what trackers were given, their own files, and the video."""
FORMAT_NUMBER = 1
"""Format of the note on what a tracker was given."""
VIDEO = "agent.mp4"
PATIENCE = 60.0
"""s to wait for uploads after the training."""
Event = Ending | Literal["evaluated", "refused"]
"""Event of a training: its curve has another row, or it ends; one that is refused has not begun."""


@contextlib.contextmanager
def tracked(
    trackers: Sequence[str], recipe: Recipe, out: Path, seed: int, resume: bool, say: Callable[[str], object]
) -> Iterator[Callable[[Mapping[str, float]], None]]:
    """Let trackers follow the training that is made in the folder `out`, or resumed there; yields its `on_evaluation`.

    In the end, an agent is filmed. `say` is told where the runs are, and once of each tracker that fails, which the
    training does not notice. A training that is refused leaves no run. Raises `ConfigurationError` for a tracker that
    there is not.
    """
    kinds = {name: load_tracker(name) for name in trackers}
    config = recipe.model_dump(mode="json", fallback=str, exclude={"seeds"}) | {"seed": seed}
    followers = [Follower(name, kind, out, config, resume, say) for name, kind in kinds.items()]
    for follower in followers:
        follower.start()

    def on_evaluation(row: Mapping[str, float]) -> None:
        for follower in followers:
            follower.tell("evaluated")

    ending: Event = "failed"
    try:
        yield on_evaluation
        ending = "finished"
    except KeyboardInterrupt:
        ending = "interrupted"
        raise
    except ConfigurationError:
        ending = "refused"
        raise
    finally:
        try:
            if followers and ending == "finished":
                _film(recipe, out, say)
            _end(followers, ending, say)
        except KeyboardInterrupt:
            say("Interrupted before all was tracked. With --resume, the same command catches up.")


class Follower(threading.Thread):
    """Gives one tracker the evaluations of a training, from the first one on, and in the end the agent."""

    def __init__(
        self, name: str, kind: type[Tracker], out: Path, config: dict[str, Any], resume: bool, say: Callable[[str], Any]
    ) -> None:
        super().__init__(name=f"Tracking by {name}", daemon=True)
        self._kind, self._out, self._config, self._say = kind, out, config, say
        self._note = out / FOLDER / f"{name}.json"
        self._resumes = resume and self._note.exists()
        self._tracker: Tracker | None = None
        self._steps = -1
        """Steps of the last row of the curve that the tracker has."""
        self._events: queue.SimpleQueue[Event] = queue.SimpleQueue()

    def tell(self, event: Event) -> None:
        """Tell the tracker what has happened to the training. Returns at once."""
        self._events.put(event)

    def run(self) -> None:
        """Follow the training until it ends, or the tracker fails."""
        try:
            while (event := self._events.get()) == "evaluated":
                self._catch_up()
            has_begun = event != "refused" and any((self._out / name).exists() for name in (SETTINGS, CURVE, CARD))
            if has_begun or self._tracker:
                tracker = self._catch_up()
                if event == "finished":
                    self._hand_over(tracker)
                tracker.finish("failed" if event == "refused" else event)
                self._say(f"{self.name}: {tracker.where}")
        except FAILURES as error:
            self._say(
                f"{self.name} failed, which does not affect the training: {_line(error)}. "
                "With --resume, the same command catches up."
            )

    def _catch_up(self) -> Tracker:
        """Give the tracker the rows of the curve that it does not have. Its run begins with the first."""
        tracker = self._tracker = self._tracker or self._begin()
        with contextlib.suppress(ResultsError):  # there is no curve
            for row in read_curve(self._out / CURVE).select_dtypes("number").to_dict("records"):
                if row["steps"] > self._steps:
                    values = {str(name): float(value) for name, value in row.items() if name != "steps"}
                    tracker.log(int(row["steps"]), {k: value for k, value in values.items() if math.isfinite(value)})
                    self._steps = int(row["steps"])
                    self._remember(tracker)
        return tracker

    def _begin(self) -> Tracker:
        folder = inside(self._out, FOLDER)
        folder.mkdir(exist_ok=True)
        run = None
        if self._resumes:
            note = unsealed(bounded_text(self._note), FORMAT_NUMBER)
            run, self._steps = note["run"], note["steps"]
        settings = self._out / SETTINGS
        config = json.loads(bounded_text(settings)) if settings.exists() else self._config
        config = {name: value for name, value in config.items() if name != FORMAT}
        tracker = self._kind(self._out.resolve().name, folder.resolve(), config, run)
        self._remember(tracker)
        return tracker

    def _remember(self, tracker: Tracker) -> None:
        write_atomically(self._note, sealed({FORMAT: FORMAT_NUMBER, "run": tracker.run, "steps": self._steps}))

    def _hand_over(self, tracker: Tracker) -> None:
        """Give the tracker the finished agent."""
        card = read_card(self._out / CARD)
        if card.evaluation is not None:
            tracker.log(card.training_steps, {"final_success": card.evaluation.success_rate})
        tracker.agent([file for file in (self._out / name for name in (GRAPH, CARD, CURVE)) if file.exists()])
        video = self._out / FOLDER / VIDEO
        if video.exists():
            tracker.video(video, card.training_steps)


def _film(recipe: Recipe, out: Path, say: Callable[[str], object]) -> None:
    """Film the finished agent, if scenes can be rendered on this machine."""
    try:
        folder = inside(out, FOLDER)
        folder.mkdir(exist_ok=True)
        (folder / VIDEO).unlink(missing_ok=True)
        film_agent(out / CARD, recipe.env, recipe.env_options, folder / VIDEO)
    except FAILURES as error:
        say(f"There is no video of the agent: {_line(error)}")


def _end(followers: Sequence[Follower], ending: Event, say: Callable[[str], object]) -> None:
    for follower in followers:
        follower.tell(ending)
    latest = time.monotonic() + PATIENCE
    for follower in followers:
        follower.join(max(0.0, latest - time.monotonic()))
        if follower.is_alive():
            say(f"{follower.name} did not end within {PATIENCE:g} s. With --resume, the same command catches up.")


def _line(error: BaseException) -> str:
    """Return an error in a line; those of MLflow's database have several."""
    return " ".join(described(error).split())

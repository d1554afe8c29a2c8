"""Records episodes for Rerun's viewer: the scene, the policy's plans, contacts, camera, joints, actions and rewards.

The timeline `step` counts control steps, and `time` is the simulation's, in seconds. Both go on from one episode to the
next.
"""

import functools
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from armctl.core.arrays import Observations
from armctl.core.errors import missing_extra, os_errors_as
from armctl.core.files import write_atomically
from armctl.datasets.pictures import bounds_of, is_image
from armctl.envs import EpisodeVectorEnv, ThirdPartyVectorEnv
from armctl.viewer.recording import check_writable
from armctl.viewer.terminal import LogOpener

if TYPE_CHECKING:
    import rerun as rr

    from armctl.integrations.rerun.scene import RerunScene

COLOURS = {"path": (40, 100, 240), "horizon": (255, 130, 10)}
"""RGB colours of plans, by name."""
OTHER_COLOUR = (150, 50, 200)
PLAN_RADIUS = 0.006
"""m."""


def rerun_opener(file: Path) -> LogOpener:
    """Return the opener of a Rerun recording in that file.

    Raises `ConfigurationError` or `ResultsError` if Rerun is missing, or the file cannot be written.
    """
    try:
        import rerun  # noqa: F401
    except ModuleNotFoundError as error:
        raise missing_extra("--rerun", error, "rerun") from error
    check_writable("Rerun recording", file, (".rrd",))
    return functools.partial(_recording, file)


@contextmanager
def _recording(file: Path, worlds: EpisodeVectorEnv, written: Callable[[Path, int], object]) -> Iterator["RerunLog"]:
    """Record episodes of the first world. The file is there at the end, even if that is an interrupt or an error.

    Calls `written` with the file and the number of control steps then. Raises `ResultsError` if it cannot be written,
    and leaves an older file as it was.
    """
    import rerun as rr

    stream = rr.RecordingStream("armctl", send_properties=False)
    content = rr.binary_stream(stream)
    log = RerunLog(stream, worlds)
    try:
        yield log
    finally:
        stream.flush()
        recorded = content.read() or b""
        stream.disconnect()
        if log.steps:
            with os_errors_as(f"the Rerun recording {file} cannot be written"):
                write_atomically(file, recorded)
            written(file, log.steps)


class RerunLog:
    """Logs control steps. An episode is a number of `decision` and `rewards`, and then `end`."""

    def __init__(self, stream: "rr.RecordingStream", worlds: EpisodeVectorEnv) -> None:
        import rerun as rr

        self.steps = 0
        """Control steps so far, in all episodes."""
        self._rr, self._stream, self._worlds = rr, stream, worlds
        self._period: float = worlds.control_period or 1 / worlds.metadata["render_fps"]
        self._moment, self._return = 0, 0.0
        self._joints: tuple[str, ...] = getattr(worlds.task.robot, "joints", ())
        self._configuration = "joints" if self._joints else "configuration"
        self._scene = None if isinstance(worlds, ThirdPartyVectorEnv) else _scene(stream, worlds)
        self._has_shapes = False
        self._plans: set[str] = set()
        self._named: set[str] = set()
        stream.send_blueprint(self._blueprint())

    def decision(self, observations: Observations, actions: NDArray[Any], plans: Mapping[str, NDArray[Any]]) -> None:
        """Log what a policy sees, does and plans, before that has any effect."""
        self._log_state(observations)
        self._scalars("action", actions[0], self._joints)
        for name, points in plans.items():
            colour = COLOURS.get(name, OTHER_COLOUR)
            line = self._rr.LineStrips3D([points], radii=PLAN_RADIUS, colors=[colour])
            self._stream.log(f"world/plans/{name}", line)
        for name in self._plans - set(plans):
            self._stream.log(f"world/plans/{name}", self._rr.Clear(recursive=False))
        self._plans = set(plans)

    def rewards(self, terms: Mapping[str, float], reward: float) -> None:
        """Log what the control step earned, by term if these are known, and advance the time to its end."""
        self._return += reward
        rewards = terms or {"reward": reward}
        self._scalars("reward", np.array(list(rewards.values())), tuple(rewards))
        self._stream.log("return", self._rr.Scalars(self._return))
        self.steps += 1
        self._moment += 1

    def end(self, observations: Observations, ending: str) -> None:
        """Log the last state of an episode, and how it ended."""
        self._log_state(observations)
        self._stream.log("episodes", self._rr.TextLog(ending))
        for name in self._plans:
            self._stream.log(f"world/plans/{name}", self._rr.Clear(recursive=False))
        self._plans, self._return, self._has_shapes = set(), 0.0, False
        self._moment += 1

    def _log_state(self, observations: Observations) -> None:
        task = self._worlds.task
        self._stream.set_time("step", sequence=self._moment)
        self._stream.set_time("time", duration=self._moment * self._period)
        if self._scene is not None:
            self._scene.log(shapes=not self._has_shapes)
            self._scalars(self._configuration, task.motion().configuration[0], self._joints)
        self._has_shapes = True
        space = self._worlds.single_observation_space
        parts = space.spaces if isinstance(space, gymnasium.spaces.Dict) else {"observation": space}
        for name, part in parts.items():
            if is_image(part):
                values = np.asarray(observations[name] if isinstance(observations, dict) else observations)[0]
                self._stream.log(f"camera/{name}", self._image(values, part))
        for name, values in task.observation_parts().items():
            if getattr(values, "ndim", 0) == 2 and values.dtype.kind in "bif":
                self._scalars(f"observation/{name}", values[0])

    def _image(self, picture: NDArray[Any], space: Any) -> Any:
        if picture.ndim == 3 and picture.shape[2] == 3:
            return self._rr.Image(picture)
        return self._rr.DepthImage(picture.reshape(picture.shape[:2]), meter=1.0, depth_range=bounds_of(space))

    def _scalars(self, path: str, values: NDArray[Any], names: tuple[str, ...] = ()) -> None:
        numbers = np.asarray(values, dtype=float).ravel()
        if path not in self._named and len(names) == len(numbers):
            self._stream.log(path, self._rr.SeriesLines(names=list(names)), static=True)
        self._named.add(path)
        self._stream.log(path, self._rr.Scalars(numbers))

    def _blueprint(self) -> Any:
        from rerun import blueprint as rrb

        plotted = (*([self._configuration] if self._scene is not None else []), "action", "reward", "return")
        plots: list[rrb.View] = [rrb.TimeSeriesView(origin=path, name=path) for path in plotted]
        space = self._worlds.single_observation_space
        parts = list(space.spaces.values()) if isinstance(space, gymnasium.spaces.Dict) else [space]
        if any(map(is_image, parts)):
            plots.insert(0, rrb.Spatial2DView(origin="camera", name="camera"))
        if self._scene is None:
            return rrb.Blueprint(rrb.Vertical(*plots))
        world = rrb.Spatial3DView(
            origin="world",
            name=self._worlds.task.instruction or "world",
            eye_controls=self._scene.eye(self._worlds.task.camera),
        )
        return rrb.Blueprint(rrb.Horizontal(world, rrb.Vertical(*plots), column_shares=[2, 1]), collapse_panels=True)


def _scene(stream: "rr.RecordingStream", worlds: EpisodeVectorEnv) -> "RerunScene":
    from armctl.integrations.rerun.scene import RerunScene  # imports Rerun

    return RerunScene(stream, worlds.task.simulation)

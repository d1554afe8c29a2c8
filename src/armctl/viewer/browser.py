"""The live viewer in the browser, by MuJoCo Studio.

The main thread plays episodes (`Player`), and Studio's thread shows them (`Panel`). Between two control steps, the
drawn state is interpolated, together with the plan that led from one to the other.
"""

import logging
import socket
import threading
import time
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.studio import launch_thread, messages, plugin, sim, viewer_protocol, web_viewer
from numpy.typing import NDArray
from websockets.exceptions import ConnectionClosed

from armctl.core.errors import ArmctlError, ConfigurationError
from armctl.envs import ThirdPartyVectorEnv
from armctl.simulation.rendering import has_screen
from armctl.simulation.scenery import STATE, Scenery, polyline
from armctl.viewer.guard import Guard, OwnProcessListener, guarded, unguarded
from armctl.viewer.panel import COLOURS, OTHER_COLOUR, SPEEDS, Frame, Panel, Play, Seek, SetSpeed
from armctl.viewer.stage import Stage, Status

LOOPBACK = "127.0.0.1"
FIRST_PORT = 8080
PAUSE = 1.5
"""s between the end of an episode and the start of the next."""
TICK = 0.01
"""s between two states that are sent to the viewer."""
LINE_WIDTH = 1.5e-3
"""Radius of lines, relative to the camera's initial distance."""


class Moment(NamedTuple):
    """State and drawing after a control step."""

    state: NDArray[np.float64]
    status: Status
    geoms: list[mujoco.MjvGeom]
    plans: tuple[str, ...]


class Player(plugin.SimPlugin):
    """Plays episodes in real time, one after the other, and handles the panel's requests."""

    def __init__(self, stage: Stage) -> None:
        if isinstance(stage.worlds, ThirdPartyVectorEnv):
            raise ConfigurationError(
                f"view shows environments that are made of tasks; {stage.env_id} has a window of its own (armctl run "
                "POLICY --env ID --watch), and videos (--video FILE.mp4)"
            )
        self.stage = stage
        self._paused, self._notice, self._speed = False, "", 1.0
        self.scenery = Scenery(stage.task.simulation, stage.task.camera)
        self._width = LINE_WIDTH * float(1.5 * self.scenery.model.stat.extent)
        self._begin()

    @messages.handler
    def on_play(self, request: Play) -> bool:
        """Start another policy, seed or episode."""
        try:
            self.stage.play(request.policy, request.seed, request.episode)
        except ArmctlError as error:
            self._notice = str(error)
            self._send()
        else:
            self._notice = ""
            self._begin()
        return True

    @messages.handler
    def on_pause(self, request: messages.RequestPauseEvent) -> bool:
        """Pause, or continue."""
        self._paused = request.pause_state != sim.PauseState.UNPAUSED
        self._due = time.perf_counter()
        self._show(self._history[-1 if not self._paused else self._shown_step])
        return True

    @messages.handler
    def on_seek(self, request: Seek) -> bool:
        """Pause at an earlier control step of this episode."""
        self._paused = True
        self._shown_step = min(max(request.step, 0), len(self._history) - 1)
        self._show(self._history[self._shown_step])
        return True

    @messages.handler
    def on_speed(self, request: SetSpeed) -> bool:
        """Play faster or slower."""
        self._speed = min(max(request.speed, SPEEDS[0]), SPEEDS[-1])
        self._send()
        return True

    @messages.handler
    def on_single_step(self, _: messages.SingleStepEvent) -> bool:
        """Make one control step, and pause."""
        self._paused = True
        self._control_step(time.perf_counter())
        return True

    @messages.handler
    def on_load(self, _: messages.LoadModelEvent) -> bool:
        """Ignore models that are dropped onto the page."""
        return True

    @messages.handler
    def on_step(self, event: messages.StepEvent) -> bool:
        """Make a control step if one is due, and show the interpolated state."""
        time_s = time.perf_counter()
        status = self.stage.status
        if not self._paused and time_s >= self._due:
            if status.outcome is None:
                self._control_step(time_s)
            else:
                self.on_play(Play(status.policy, status.seed, status.episode + 1))
        share = np.clip((time_s - self._stepped) / self._interval, 0.0, 1.0)
        mujoco.mj_setState(
            event.model, event.data, self._previous_state + share * (self._state - self._previous_state), STATE
        )
        time.sleep(TICK)
        return True

    @property
    def _interval(self) -> float:
        """Seconds between two control steps, at the present speed."""
        return self.stage.period / self._speed

    def _begin(self) -> None:
        self.scenery.simulation = self.stage.task.simulation
        self._history = [self._moment()]
        self._stepped = self._due = time.perf_counter()
        self._show(self._history[0])

    def _control_step(self, time_s: float) -> None:
        previous = self._history[-1]
        if self.stage.status.outcome is None:
            self.stage.step()
            self._history.append(self._moment())
        is_late = time_s - self._due > self._interval
        self._stepped, self._due = time_s, (time_s if is_late else self._due) + self._interval
        if self.stage.status.outcome is not None:
            self._due += PAUSE
        self._show(self._history[-1])
        self._previous_state = previous.state

    def _moment(self) -> Moment:
        state, geoms = self.scenery.snapshot()
        plans = self.stage.plans()
        for name, points in plans.items():
            colour = COLOURS.get(name, OTHER_COLOUR)
            geoms += polyline(points, self._width, colour, beads=name == "horizon")
        return Moment(state, self.stage.status, geoms, tuple(plans))

    def _show(self, moment: Moment) -> None:
        self._shown_step = moment.status.steps
        self._previous_state = self._state = moment.state
        self._send()

    def _send(self) -> None:
        _, status, geoms, plans = self._history[self._shown_step]
        last_step = len(self._history) - 1
        self.frame = Frame(status, self._paused, self._speed, last_step, geoms, plans, self._notice)
        if self._handle is not None:
            self.handle.send_to_viewer(self.frame)


class LoopbackViewer(web_viewer.WebViewer):
    """Studio's web viewer, for this machine and behind a guard. Studio's own is open to all who reach the machine."""

    _host = property(lambda self: LOOPBACK, lambda self, host: None)

    @messages.handler(priority=messages.Priority.INTERNAL)
    def _on_post_model(self, _: messages.PostModelEvent) -> None:
        """Serve the model, without Studio's line in the terminal."""
        self._update_model()

    _tcp_sock: socket.socket

    def __init__(self, config: viewer_protocol.ViewerConfig, *args: Any, **kwargs: Any) -> None:
        with _silence():
            super().__init__(replace(config, open_browser=False), *args, **kwargs)
        print(f"The page, for this machine only: {self.guard.address}\nCtrl-C ends the program.", flush=True)
        if config.open_browser and has_screen():
            threading.Thread(target=webbrowser.open, args=(self.guard.address, 2), daemon=True).start()

    def _start_server(self) -> None:
        address, port = self._http_sock.getsockname()
        if address != LOOPBACK:  # another version of Studio may not read `_host`
            raise unguarded()
        self._tcp_sock = OwnProcessListener(fileno=self._tcp_sock.detach())
        self.guard = Guard(port)
        logging.getLogger("WebServer").addFilter(lambda record: record.levelno >= logging.WARNING)
        logging.getLogger("asyncio").addFilter(lambda record: not _is_of_a_closed_page(record))
        with guarded(self.guard):
            super()._start_server()


def _is_of_a_closed_page(record: logging.LogRecord) -> bool:
    """True for the traceback of a state that Studio was sending to a page when that was closed or loaded again."""
    return record.exc_info is not None and isinstance(record.exc_info[1], ConnectionClosed)


@contextmanager
def _silence() -> Iterator[None]:
    """Leave out Studio's words about the page: they warn of a network that cannot reach it, and lack the token."""
    theirs = getattr(web_viewer, "_print_url_banner", None)
    web_viewer._print_url_banner = lambda *_: None
    try:
        yield
    finally:
        web_viewer._print_url_banner = theirs


def show_in_browser(player: Player, port: int = 0, open_browser: bool = True) -> None:
    """Play until the viewer ends. `port` 0 means the first free one from `FIRST_PORT` on.

    Raises `ConfigurationError` for a port that is not available.
    """
    _check_port(port)
    panel = Panel(player.stage)
    config = viewer_protocol.ViewerConfig(title="armctl", gfx="web", http_port=port, open_browser=open_browser)

    def show(endpoint: Any) -> None:
        viewer_protocol.run_viewer_loop(LoopbackViewer(config, endpoint, plugins=[panel]))

    with launch_thread.launch_thread(show, sim_plugins=[player]) as handle:
        handle.set_model(player.scenery.model)
        while handle.is_running():
            handle.sync()


def _check_port(port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except OSError as error:
            raise ConfigurationError(
                f"port {port} is not available ({error.strerror}): choose another one, or none for the first free one "
                f"from {FIRST_PORT} on"
            ) from error

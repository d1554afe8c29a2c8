"""The live viewer in the browser, by MuJoCo Studio.

The main thread plays episodes in real time (`Player`), and Studio's thread shows them (`Panel`). Between two control
steps, the drawn state is interpolated, together with the plan that led from one to the other.
"""

import socket
import threading
import time
import webbrowser
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from mujoco.studio import launch_thread, messages, plugin, sim, ux, viewer_protocol, web_viewer
from mujoco.studio.dear_imgui import dear_imgui as imgui

from armctl.core.errors import ArmctlError, ConfigurationError
from armctl.envs import ThirdPartyVectorEnv
from armctl.policies import policy_names
from armctl.simulation.rendering import has_screen
from armctl.simulation.scenery import STATE, Scenery, polyline
from armctl.viewer.guard import Guard, OwnProcessListener, guarded, unguarded
from armctl.viewer.stage import Stage, Status

LOOPBACK = "127.0.0.1"
FIRST_PORT = 8080
PAUSE = 1.5
"""s between the end of an episode and the start of the next."""
TICK = 0.01
"""s between two states that are sent to the viewer."""
LINE_WIDTH = 1.5e-3
"""Radius of lines, relative to the camera's initial distance."""
COLOURS = {"path": (0.15, 0.4, 0.95, 0.9), "horizon": (1.0, 0.5, 0.05, 1.0)}
"""RGBA colours of plans, by name."""
OTHER_COLOUR = (0.6, 0.2, 0.8, 0.9)
BUTTON_WIDTH = 64.0
"""Pixels."""
PANEL = (12.0, 12.0, 360.0, 0.0)
"""Initial position and size of the panel, pixels; 0 fits the content."""


@dataclass(frozen=True)
class Play(messages.Event):
    """Message from the panel to the player: begin this episode."""

    policy: str
    seed: int
    episode: int


@dataclass(frozen=True)
class Frame(messages.Snapshot):
    """Message from the player to the panel: content to show."""

    status: Status
    paused: bool
    geoms: list[mujoco.MjvGeom]
    plans: tuple[str, ...]
    notice: str
    """Reason for which a request failed."""


class Player(plugin.SimPlugin):
    """Plays episodes in real time, one after the other, and handles the panel's requests."""

    def __init__(self, stage: Stage) -> None:
        if isinstance(stage.worlds, ThirdPartyVectorEnv):
            raise ConfigurationError(
                f"view shows environments that are made of tasks; {stage.env_id} has a window of its own (armctl run "
                "POLICY --env ID --watch), and videos (--video FILE.mp4)"
            )
        self.stage = stage
        self._paused, self._notice = False, ""
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
        share = np.clip((time_s - self._stepped) / self.stage.period, 0.0, 1.0)
        mujoco.mj_setState(
            event.model, event.data, self._previous_state + share * (self._state - self._previous_state), STATE
        )
        time.sleep(TICK)
        return True

    def _begin(self) -> None:
        self.scenery.simulation = self.stage.task.simulation
        self._state, geoms = self.scenery.snapshot()
        self._previous_state = self._state
        self._stepped = self._due = time.perf_counter()
        self._show(geoms)

    def _control_step(self, time_s: float) -> None:
        self.stage.step()
        self._previous_state = self._state
        self._state, geoms = self.scenery.snapshot()
        is_late = time_s - self._due > self.stage.period
        self._stepped, self._due = time_s, (time_s if is_late else self._due) + self.stage.period
        if self.stage.status.outcome is not None:
            self._due += PAUSE
        self._show(geoms)

    def _show(self, geoms: list[mujoco.MjvGeom]) -> None:
        plans = self.stage.plans()
        for name, points in plans.items():
            colour = COLOURS.get(name, OTHER_COLOUR)
            geoms += polyline(points, self._width, colour, beads=name == "horizon")
        self._drawing = geoms, tuple(plans)
        self._send()

    def _send(self) -> None:
        self.frame = Frame(self.stage.status, self._paused, *self._drawing, self._notice)
        if self._handle is not None:
            self.handle.send_to_viewer(self.frame)


class Panel(plugin.ViewerPlugin):
    """Shows the episode's status, sends requests to the player, and draws plans into the scene."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._policies = sorted({stage.status.policy, *policy_names()})
        self._frame = Frame(stage.status, False, [], (), "")
        self._theme = ux.GuiTheme.DARK

    @messages.handler
    def on_theme(self, event: plugin.ThemeEvent) -> None:
        """Follow the browser's light or dark theme."""
        self._theme = event.theme

    @messages.handler
    def on_model(self, event: messages.PostModelEvent) -> None:
        """Point the camera at the world."""
        mujoco.mjv_defaultFreeCamera(event.model, self.viewer.camera)

    @messages.handler
    def on_frame(self, frame: Frame) -> None:
        """Store what to show."""
        self._frame = frame

    @messages.handler
    def on_update(self, _: messages.UpdateEvent) -> None:
        """Draw targets and plans into the scene."""
        self.viewer.extra_geoms[:] = self._frame.geoms

    @messages.handler
    def on_build_gui(self, _: messages.BuildGuiEvent) -> None:
        """Lay the panel out."""
        x, y, width, height = PANEL
        imgui.SetNextWindowPos(imgui.Vec2(x, y), int(imgui.Cond.FirstUseEver))
        imgui.SetNextWindowSize(imgui.Vec2(width, height))
        ux.setup_theme(self._theme)
        imgui.Begin("armctl", flags=int(imgui.WindowFlags.NoTitleBar))
        imgui.TextUnformatted(self._stage.env_id)
        self._build_choices_gui()
        self._build_buttons_gui()
        self._build_status_gui()
        imgui.End()

    def _build_choices_gui(self) -> None:
        status = self._frame.status
        policy = status.policy
        if imgui.BeginCombo("policy", policy):
            for name in self._policies:
                if imgui.Selectable(name, name == status.policy):
                    policy = name
            imgui.EndCombo()
        enter = int(imgui.InputTextFlags.EnterReturnsTrue)
        _, seed = imgui.InputInt("seed", status.seed, 1, 100, enter)
        _, episode = imgui.InputInt("episode", status.episode, 1, 100, enter)
        if (policy, seed, episode) != (status.policy, status.seed, status.episode):
            self._request(Play(policy, max(seed, 0), max(episode, 0)))

    def _build_buttons_gui(self) -> None:
        status, paused = self._frame.status, self._frame.paused
        if self._button("Play" if paused else "Pause", imgui.Key.Space, "Space"):
            self._request(messages.RequestPauseEvent(sim.PauseState(not paused)))
        if self._button("Step", imgui.Key.RightArrow, "Right arrow: one control step"):
            self._request(messages.SingleStepEvent())
        if self._button("Restart", imgui.Key.R, "R: restart this episode"):
            self._request(Play(status.policy, status.seed, status.episode))
        if self._button("Next", imgui.Key.N, "N: start the next episode"):
            self._request(Play(status.policy, status.seed, status.episode + 1))
        imgui.NewLine()

    def _build_status_gui(self) -> None:
        rows = rows_of(self._frame.status, self._stage)
        for name, text in rows.items():
            imgui.TextDisabled(name)
            imgui.SameLine(100)
            imgui.TextWrapped(text)
        for name in self._frame.plans:
            imgui.TextColored(imgui.Vec4(*COLOURS.get(name, OTHER_COLOUR)), f"- {name}")
        if self._frame.notice:
            imgui.Separator()
            imgui.TextWrapped(self._frame.notice)

    def _button(self, label: str, key: Any, hint: str) -> bool:
        pressed = imgui.Button(label, imgui.Vec2(BUTTON_WIDTH, 0.0))
        imgui.SetItemTooltip(hint)
        imgui.SameLine()
        return bool(pressed or (not imgui.IsAnyItemActive() and imgui.IsKeyPressed(key, False)))

    def _request(self, request: messages.Event) -> None:
        self.viewer.send_to_sim(request)


def rows_of(status: Status, stage: Stage) -> dict[str, str]:
    """Return the status of an episode as text, by name."""
    rewards = ", ".join(f"{name} {value:g}" for name, value in status.rewards.items())
    of = "" if stage.longest is None else f" of {stage.longest}"
    ending = "" if status.outcome is None else f": {status.outcome}"
    return {
        "step": f"{status.steps}{of}, {status.steps * stage.period:.2f} s{ending}",
        "return": f"{status.total_reward:.4g}" + (f"  ({rewards})" if rewards else ""),
        "distance": f"{status.distance:.3f} m",
        "contacts": _contact_text(status.contacts),
        "decision time": f"{status.decision_ms:.2f} ms",
    }


def _contact_text(contacts: Mapping[str, tuple[str, ...]]) -> str:
    return "; ".join(f"{thing}: {', '.join(parts)}" if parts else thing for thing, parts in contacts.items()) or "none"


class LoopbackViewer(web_viewer.WebViewer):
    """Studio's web viewer, for this machine and behind a guard. Studio's own is open to all who reach the machine."""

    _host = property(lambda self: LOOPBACK, lambda self, host: None)
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
        with guarded(self.guard):
            super()._start_server()


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

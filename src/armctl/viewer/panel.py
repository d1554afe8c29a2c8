"""The panel of the viewer's page: the messages between it and the player, and its buttons, sliders and status."""

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
from mujoco.studio import messages, plugin, sim, ux
from mujoco.studio.dear_imgui import dear_imgui as imgui

from armctl.policies import policy_names
from armctl.viewer.stage import Stage, Status

COLOURS = {"path": (0.15, 0.4, 0.95, 0.9), "horizon": (1.0, 0.5, 0.05, 1.0)}
"""RGBA colours of plans, by name."""
OTHER_COLOUR = (0.6, 0.2, 0.8, 0.9)
BUTTON_WIDTH = 64.0
"""Pixels."""
MARGIN, PANEL_WIDTH = 12.0, 360.0
"""Initial distance of the panel from the page's corner, and its width where there is room for it, pixels."""
NARROW_PAGE = 600.0
"""Pixels: on a narrower page, such as a phone's, the status is folded away at first."""
LINE_LENGTH = 36
"""Characters of a line of the status."""
SPEEDS = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0)
"""Playback speeds, relative to real time."""


@dataclass(frozen=True)
class Play(messages.Event):
    """Message from the panel to the player: begin this episode."""

    policy: str
    seed: int
    episode: int


@dataclass(frozen=True)
class Seek(messages.Event):
    """Message from the panel to the player: pause, and show this control step of the episode so far."""

    step: int


@dataclass(frozen=True)
class SetSpeed(messages.Event):
    """Message from the panel to the player: play so many times as fast as real time."""

    speed: float


@dataclass(frozen=True)
class Frame(messages.Snapshot):
    """Message from the player to the panel: content to show."""

    status: Status
    paused: bool
    speed: float
    last_step: int
    """Number of control steps so far; the status is that of an earlier one while somebody looks back."""
    geoms: list[mujoco.MjvGeom]
    plans: tuple[str, ...]
    notice: str
    """Reason for which a request failed."""


class Panel(plugin.ViewerPlugin):
    """Shows the episode's status, sends requests to the player, and draws plans into the scene."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._policies = sorted({stage.status.policy, *policy_names()})
        self._frame = Frame(stage.status, False, 1.0, 0, [], (), "")
        self._theme = ux.GuiTheme.DARK
        self._contact_colour = OTHER_COLOUR

    @messages.handler
    def on_theme(self, event: plugin.ThemeEvent) -> None:
        """Follow the browser's light or dark theme."""
        self._theme = event.theme

    @messages.handler
    def on_model(self, event: messages.PostModelEvent) -> None:
        """Point the camera at the world."""
        mujoco.mjv_defaultFreeCamera(event.model, self.viewer.camera)
        self._contact_colour = tuple(event.model.vis.rgba.contactpoint)

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
        page_width = imgui.GetIO().DisplaySize.x
        imgui.SetNextWindowPos(imgui.Vec2(MARGIN, MARGIN), int(imgui.Cond.FirstUseEver))
        imgui.SetNextWindowSize(imgui.Vec2(min(PANEL_WIDTH, page_width - 2 * MARGIN), 0.0))
        ux.setup_theme(self._theme)
        imgui.Begin("armctl", flags=int(imgui.WindowFlags.NoTitleBar))
        imgui.TextUnformatted(self._stage.env_id)
        self._build_choices_gui()
        self._build_buttons_gui()
        self._build_time_gui()
        unfolded = imgui.TreeNodeFlags.DefaultOpen if page_width > NARROW_PAGE else 0
        if imgui.CollapsingHeader("status", flags=int(unfolded)):
            self._build_status_gui()
        if self._frame.notice:
            imgui.Separator()
            imgui.TextWrapped(self._frame.notice)
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

    def _build_time_gui(self) -> None:
        """Lay out the slider of control steps, with which to look back, and the playback speed."""
        frame = self._frame
        moved, step = imgui.SliderInt("step", frame.status.steps, 0, max(frame.last_step, 1))
        if moved:
            self._request(Seek(step))
        if imgui.BeginCombo("speed", f"{frame.speed:g} x"):
            for speed in SPEEDS:
                if imgui.Selectable(f"{speed:g} x", speed == frame.speed):
                    self._request(SetSpeed(speed))
            imgui.EndCombo()

    def _build_status_gui(self) -> None:
        rows = rows_of(self._frame.status, self._stage)
        for name, text in rows.items():
            imgui.TextDisabled(name)
            imgui.SameLine(100)
            imgui.TextUnformatted(textwrap.fill(text, LINE_LENGTH))
        legend = {name: COLOURS.get(name, OTHER_COLOUR) for name in self._frame.plans}
        if self._frame.status.contacts:
            legend["point of contact"] = self._contact_colour
        for name, colour in legend.items():
            imgui.TextColored(imgui.Vec4(*colour), f"- {name}")

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

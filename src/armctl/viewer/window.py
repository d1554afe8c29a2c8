"""The live viewer in MuJoCo's own window, with keys instead of a panel (Studio's window needs Python 3.12)."""

import queue

import mujoco
from mujoco.studio import messages, sim

from armctl.core.errors import ConfigurationError
from armctl.simulation.rendering import has_screen
from armctl.viewer.browser import Player
from armctl.viewer.panel import Frame, Play, rows_of

SPACE, RIGHT, AGAIN, NEXT = 32, 262, ord("R"), ord("N")
"""GLFW's key codes."""
COPIED = ("type", "dataid", "objtype", "objid", "category", "matid", "emission", "specular", "shininess", "reflectance")


def check_screen() -> None:
    """Raise `ConfigurationError` on a machine without a screen."""
    if not has_screen():
        raise ConfigurationError("--native needs a display, and there is none: without it, the viewer uses a browser")


def show_in_window(player: Player) -> None:
    """Play until the window is closed."""
    import mujoco.viewer as viewer  # loads GLFW, which only a window needs

    pressed: queue.SimpleQueue[int] = queue.SimpleQueue()
    model = player.scenery.model
    data = mujoco.MjData(model)
    with viewer.launch_passive(
        model, data, key_callback=pressed.put, show_left_ui=False, show_right_ui=False
    ) as window:
        mujoco.mjv_defaultFreeCamera(model, window.cam)
        while window.is_running():
            while not pressed.empty():
                _handle_key(player, pressed.get())
            with window.lock():
                player.on_step(messages.StepEvent(model, data))
                mujoco.mj_forward(model, data)
                _decorate(window.user_scn, player.frame)
            rows = rows_of(player.frame.status, player.stage)
            corner, size = mujoco.mjtGridPos.mjGRID_TOPLEFT, mujoco.mjtFontScale.mjFONTSCALE_150
            window.set_texts((size, corner, "\n".join(rows), "\n".join(rows.values())))
            window.sync()


def _handle_key(player: Player, key: int) -> None:
    status = player.frame.status
    if key == SPACE:
        player.on_pause(messages.RequestPauseEvent(sim.PauseState(not player.frame.paused)))
    elif key == RIGHT:
        player.on_single_step(messages.SingleStepEvent())
    elif key in (AGAIN, NEXT):
        player.on_play(Play(status.policy, status.seed, status.episode + (key == NEXT)))


def _decorate(scene: mujoco.MjvScene, frame: Frame) -> None:
    geoms = frame.geoms[: scene.maxgeom]
    for source, target in zip(geoms, scene.geoms, strict=False):
        for name in COPIED:
            setattr(target, name, getattr(source, name))
        for name in ("size", "pos", "mat", "rgba"):
            getattr(target, name)[:] = getattr(source, name)
    scene.ngeom = len(geoms)

"""Images of a world: off-screen as arrays, or in MuJoCo's window."""

import os
import sys
import warnings
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.core.errors import ConfigurationError

_NO_GRAPHICS = (
    "images need OpenGL, and MuJoCo found none ({cause}). On Debian or Ubuntu: apt-get install libegl1 "
    "libgl1-mesa-dri (software rendering will do); import armctl before mujoco, or set MUJOCO_GL=egl yourself"
)


def has_screen() -> bool:
    """Return False on a Linux machine without a display."""
    return sys.platform != "linux" or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))


class Camera:
    """Off-screen images of worlds of one model; raises `ConfigurationError` without OpenGL."""

    def __init__(
        self, model: mujoco.MjModel, camera: str | mujoco.MjvCamera, width: int = 640, height: int = 480
    ) -> None:
        try:
            with warnings.catch_warnings(action="ignore"):  # GLFW's warnings precede the error
                self._renderer = mujoco.Renderer(model, height, width)
        except Exception as error:  # each OpenGL back end raises its own type
            raise ConfigurationError(_NO_GRAPHICS.format(cause=error)) from error
        self._camera = camera

    def picture(self, data: mujoco.MjData) -> NDArray[np.uint8]:
        """Return an image (height, width, 3) of the world in `data`."""
        self._renderer.update_scene(data, self._camera)
        return np.asarray(self._renderer.render())

    def close(self) -> None:
        """Free the graphics memory."""
        self._renderer.close()


class Window:
    """MuJoCo's native viewer, following one world."""

    def __init__(self, model: mujoco.MjModel) -> None:
        if not has_screen():
            raise ConfigurationError(
                "render_mode='human' opens a window, but there is no display. Use render_mode='rgb_array', "
                "or `armctl run POLICY --video FILE.mp4`"
            )
        import mujoco.viewer as viewer  # initialises GLFW, which only a window needs

        self._model = model
        self._data = mujoco.MjData(model)
        self._viewer: Any = viewer.launch_passive(model, self._data, show_left_ui=False, show_right_ui=False)

    def show(self, state: mujoco.MjData) -> None:
        """Show the world in `state`."""
        mujoco.mj_copyData(self._data, self._model, state)
        self._viewer.sync()

    def close(self) -> None:
        """Close the window."""
        self._viewer.close()

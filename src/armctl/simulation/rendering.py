"""Pictures of a world: off-screen as arrays, or in MuJoCo's own window."""

import os
import sys
import warnings
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from armctl.errors import ConfigurationError

_NO_GRAPHICS = (
    "pictures need OpenGL, and MuJoCo found none ({cause}). On Debian or Ubuntu: apt-get install libegl1 "
    "libgl1-mesa-dri (software rendering will do); import armctl before mujoco, or set MUJOCO_GL=egl yourself"
)


class Camera:
    """Off-screen pictures of worlds of one model; raises `ConfigurationError` where there is no OpenGL."""

    def __init__(
        self, model: mujoco.MjModel, camera: str | mujoco.MjvCamera, width: int = 640, height: int = 480
    ) -> None:
        try:
            with warnings.catch_warnings(action="ignore"):  # GLFW's, before the error that says it all
                self._renderer = mujoco.Renderer(model, height, width)
        except Exception as error:  # each OpenGL back end fails in its own way
            raise ConfigurationError(_NO_GRAPHICS.format(cause=error)) from error
        self._camera = camera

    def picture(self, data: mujoco.MjData) -> NDArray[np.uint8]:
        """Picture (height, width, 3) of the world in `data`."""
        self._renderer.update_scene(data, self._camera)
        return np.asarray(self._renderer.render())

    def close(self) -> None:
        """Give the graphics memory back."""
        self._renderer.close()


class Window:
    """MuJoCo's native viewer, following one world."""

    def __init__(self, model: mujoco.MjModel) -> None:
        if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
            raise ConfigurationError(
                "render_mode='human' opens a window, and there is no display here. Use render_mode='rgb_array', "
                "or `armctl run POLICY --video FILE.mp4`"
            )
        import mujoco.viewer as viewer  # opens GLFW, which only a window needs

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

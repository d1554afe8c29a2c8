"""Beliefs of a controller: its robot, delay and surroundings, from noisy readings. No MuJoCo, no Gymnasium in here."""

from typing import TYPE_CHECKING

from armctl.core.lazy import on_first_use

if TYPE_CHECKING:
    from armctl.estimation.arm_observer import ArmObserver
    from armctl.estimation.delay import DelayPredictor
    from armctl.estimation.drive_observer import DriveObserver
    from armctl.estimation.kalman import KalmanFilter

__all__ = ["ArmObserver", "DelayPredictor", "DriveObserver", "KalmanFilter"]

__getattr__, __dir__ = on_first_use(__name__)

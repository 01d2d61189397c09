"""Hall speed control of one drive: feed-forward by voltage, PI on the speed."""

from __future__ import annotations

from collections import deque

from liftgate_hil.ecu.calibration import Calibration


class SpeedSensor:
    """Speed [counts/s] from the counter, differenced over a few cycles."""

    def __init__(self, calibration: Calibration) -> None:
        self._history: deque[float] = deque(maxlen=calibration.speed_window + 1)
        self._cycle = calibration.cycle
        self.speed = 0.0

    def update(self, count: float) -> float:
        """Take the count of this cycle."""
        self._history.append(count)
        spans = len(self._history) - 1
        if spans:
            self.speed = (self._history[-1] - self._history[0]) / (spans * self._cycle)
        return self.speed


class SpeedController:
    """Signed duty (−1…1) for a wanted speed."""

    def __init__(self, calibration: Calibration) -> None:
        self._c = calibration
        self._integral = 0.0

    def reset(self) -> None:
        """Forget the load."""
        self._integral = 0.0

    def update(self, wanted: float, speed: float, voltage: float) -> float:
        """One cycle; the integral stops where the duty saturates."""
        c = self._c
        boost = c.rated_voltage / max(voltage, 4.0)
        error = wanted - speed
        feed_forward = wanted / c.rated_speed
        duty = (feed_forward + c.gain * error + self._integral) * boost
        limited = min(max(duty, -1.0), 1.0)
        if duty == limited or (duty > 0.0) != (error > 0.0):
            self._integral += c.gain * error * c.cycle / c.integral_time
        return limited

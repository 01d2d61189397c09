"""The state machine of the gate: closed, opening, open, closing, stopped, reversing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum

from liftgate_hil.ecu.anti_trap import AntiTrap, Verdict
from liftgate_hil.ecu.calibration import Calibration
from liftgate_hil.ecu.speed_control import SpeedController, SpeedSensor


class GateState(Enum):
    """Where the gate is in its life."""

    CLOSED = "closed"
    OPENING = "opening"
    OPEN = "open"
    CLOSING = "closing"
    STOPPED = "stopped"
    REVERSING = "reversing"


MOVING = (GateState.OPENING, GateState.CLOSING, GateState.REVERSING)


@dataclass(frozen=True)
class Feedback:
    """What the bus says, per drive; positive opens."""

    currents: Sequence[float]  # A
    counts: Sequence[float]
    latched: bool
    voltage: float  # V


@dataclass(frozen=True)
class DriveCommand:
    """What the bus is told: signed duty per drive (−1…1), None to coast."""

    duties: Sequence[float | None]
    latch_release: bool = False


@dataclass(frozen=True)
class Event:
    """Something worth telling."""

    time: float
    text: str
    verdict: Verdict | None = None


class Controller:
    """One `update` a control cycle. No I/O; time is model time in seconds."""

    def __init__(self, drives: int, calibration: Calibration | None = None) -> None:
        self._c = calibration or Calibration()
        self._drives = range(drives)
        self._sensors = [SpeedSensor(self._c) for _ in self._drives]
        self._speed = [SpeedController(self._c) for _ in self._drives]
        self._guard = {
            GateState.OPENING: AntiTrap(self._c),
            GateState.CLOSING: AntiTrap(self._c),
        }
        self.state: GateState | None = None
        self.events: list[Event] = []
        self.travel: float | None = None  # counts from closed to open, once learned
        self._zero: list[float] | None = None  # counts when closed
        self._since = 0.0
        self._brake_until = 0.0
        self._still = 0.0
        self._free: float | None = None  # position where the drives last ran without unusual load
        self._start: list[float] = []  # counts when the motion began
        self._now = 0.0

    def request(self, action: str) -> None:
        """The driver's button: open, close or stop."""
        if action == "stop" and self.state in MOVING:
            self._enter(GateState.STOPPED, "stopped by the driver")
        elif action == "open" and self.state not in (GateState.OPEN, GateState.OPENING):
            self._enter(GateState.OPENING, "opening")
        elif action == "close" and self.state not in (GateState.CLOSED, GateState.CLOSING):
            self._enter(GateState.CLOSING, "closing")

    def update(self, now: float, feedback: Feedback) -> DriveCommand:
        """One control cycle."""
        self._now = now
        self._counts = list(feedback.counts)
        for sensor, count in zip(self._sensors, feedback.counts, strict=True):
            sensor.update(count)
        if self.state is None:
            self._begin(feedback)
        if self.state not in MOVING:
            return self._hold()
        return self._move(feedback)

    # What the ECU knows of the gate.

    def position(self) -> float | None:
        """Mean counts above closed, None while closed is not known."""
        if self._zero is None:
            return None
        return sum(c - z for c, z in zip(self._counts, self._zero, strict=True)) / len(self._zero)

    def _place(self) -> float | None:
        position = self.position()
        if position is None or self.travel is None:
            return None
        return position / self.travel

    def _mean_speed(self) -> float:
        return sum(sensor.speed for sensor in self._sensors) / len(self._sensors)

    # States.

    def _begin(self, feedback: Feedback) -> None:
        self._enter(GateState.CLOSED if feedback.latched else GateState.STOPPED, "")
        if feedback.latched:
            self._zero = list(feedback.counts)

    def _enter(self, state: GateState, text: str, verdict: Verdict | None = None) -> None:
        if self.state in MOVING and state not in MOVING:
            self._brake_until = self._now + self._c.hold_time
        self.state = state
        self._since = self._now
        self._still = 0.0
        self._free = None
        if text:
            self.events.append(Event(self._now, text, verdict))
        if state in MOVING:
            self._start = list(self._counts)
            for control in self._speed:
                control.reset()
        if state in self._guard:
            self._guard[state].begin()

    def _hold(self) -> DriveCommand:
        """Brake for a moment, then coast: the spindle holds the gate by itself."""
        braking = self._now < self._brake_until
        return DriveCommand([0.0 if braking else None for _ in self._drives])

    def _move(self, feedback: Feedback) -> DriveCommand:
        assert self.state is not None
        sign = -1.0 if self.state is GateState.CLOSING else 1.0
        if self.state is GateState.CLOSING and feedback.latched:
            self._zero = list(feedback.counts)
            self._guard[GateState.CLOSING].learn()
            self._enter(GateState.CLOSED, "closed and latched")
            return self._hold()
        self._watch_ends(sign)
        if self.state in self._guard:
            self._watch_trap(feedback, sign)
        if self.state not in MOVING:
            return self._hold()
        sign = -1.0 if self.state is GateState.CLOSING else 1.0
        wanted = sign * self._wanted_speed()
        if self.state is GateState.REVERSING and self._mean_speed() < 0.0:
            return DriveCommand([1.0 for _ in self._drives])  # off the obstacle before all else
        duties = [self._drive(index, wanted, feedback.voltage) for index in self._drives]
        elapsed = self._now - self._since
        release = sign > 0.0 and feedback.latched and elapsed < self._c.latch_pulse
        return DriveCommand(duties, release)

    def _drive(self, index: int, wanted: float, voltage: float) -> float:
        """One drive's duty: the wanted speed, less what this drive is ahead of the others."""
        gone = [count - start for count, start in zip(self._counts, self._start, strict=True)]
        ahead = gone[index] - sum(gone) / len(gone)
        target = wanted - self._c.tie * ahead
        return self._speed[index].update(target, self._sensors[index].speed, voltage)

    def _cruise(self) -> float:
        if self.travel is None:
            return self._c.learning_speed
        closing = self.state is GateState.CLOSING
        return self.travel / (self._c.closing_time if closing else self._c.opening_time)

    def _wanted_speed(self) -> float:
        """Soft start over time, soft stop over the way that is left."""
        c = self._c
        cruise = self._cruise()
        speed = min(cruise, c.creep_speed + cruise * (self._now - self._since) / c.start_time)
        left = self._way_left()
        if left is not None:
            span = c.stop_distance * (self.travel or 10.0 * cruise / 3.5)
            speed = min(speed, max(c.creep_speed, cruise * left / span))
        return speed

    def _way_left(self) -> float | None:
        position = self.position()
        if position is None:
            return None
        if self.state is GateState.CLOSING:
            return max(position - self._c.seal_zone, 0.0)
        if self.travel is None:
            return None
        return max(self.travel - position, 0.0)

    def _watch_ends(self, sign: float) -> None:
        """Learned end, stall in the stop, end of a reversal."""
        c = self._c
        position, state = self.position(), self.state
        if state is GateState.REVERSING:
            gone = sum(self._counts) / len(self._counts) - sum(self._start) / len(self._start)
            if gone >= c.reverse_distance * (self.travel or 1000.0):
                self._enter(GateState.STOPPED, "reversal done, stopped")
                return
        if (
            state is not GateState.CLOSING
            and self.travel is not None
            and position is not None
            and position >= self.travel - c.end_margin
        ):
            if state is GateState.OPENING:
                self._guard[GateState.OPENING].learn()
            self._enter(GateState.OPEN, "open")
            return
        speed = sign * self._mean_speed()
        standing = speed < c.stall_speed
        self._still = self._still + c.cycle if standing else 0.0
        in_seal = state is GateState.CLOSING and position is not None and position < c.seal_zone
        limit = c.seal_stall_time if in_seal else c.stall_time
        if self._still < limit or self._now - self._since < c.start_time:
            return
        if state is GateState.CLOSING:
            self._enter(GateState.REVERSING, "blocked while closing: reversing")
        elif state is GateState.OPENING and self.travel is None:
            # The stalled drive has squeezed the mechanism; the stop is where the load began.
            if self._free is not None:
                self.travel = self._free
                self._guard[GateState.OPENING].learn()
            self._enter(GateState.OPEN, f"open, travel learned: {self.travel or 0.0:.0f} counts")
        else:
            self._enter(GateState.STOPPED, "blocked while opening: stopped")

    def _watch_trap(self, feedback: Feedback, sign: float) -> None:
        state = self.state
        assert state is not None
        position = self.position()
        if state is GateState.CLOSING and position is not None and position < self._c.seal_zone:
            return
        starting = self._now - self._since < self._c.start_time + self._c.blank_time
        verdict = self._guard[state].update(
            sign * sum(feedback.currents) / len(feedback.currents),
            sign * self._mean_speed(),
            self._wanted_speed(),
            self._place(),
            starting,
            slowing=self._wanted_speed() < 0.95 * self._cruise(),
        )
        if not self._guard[state].loaded:
            self._free = position
        # While the travel is being learned, the stop that is looked for is no obstacle.
        if verdict is None or (state is GateState.OPENING and self.travel is None):
            return
        why = (
            f"{verdict.current:.2f} A against {verdict.reference:.2f} A, "
            f"speed {100.0 * verdict.drop:.0f} % down"
        )
        if state is GateState.CLOSING:
            self._enter(GateState.REVERSING, f"trapped while closing ({why}): reversing", verdict)
        else:
            self._enter(GateState.STOPPED, f"trapped while opening ({why}): stopped", verdict)

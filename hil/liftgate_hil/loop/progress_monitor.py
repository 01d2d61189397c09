"""Progress monitor: reports a run's status, what it waits for, refused frames and the ECU's events while it runs.

Of the refused frames it reports the first one for each cause. It looks a few times a second, from outside the
loop.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from liftgate_hil.codec.receive import slot_of
from liftgate_hil.codec.refusals import ACCEPTED, FOREIGN
from liftgate_hil.loop.listener import Listener, RunStatus
from liftgate_hil.loop.refusal_texts import ANOTHER, REFUSED, RefusalTexts, gaps_text, identifier_text, missing_of
from liftgate_hil.signals import COLUMN_PLACE
from liftgate_hil.transport.base import NO_ERRORS, LinkCounts

if TYPE_CHECKING:
    from liftgate_hil.codec.receive import Reception
    from liftgate_hil.config.rig import Rig
    from liftgate_hil.ecu.events import Event
    from liftgate_hil.loop.tick import LoopConfig

_EVERY_S = 0.1  # between two looks
_MANY, _MISSING = 50, 0.3  # frames of the command, and share that is missing, from which on that is reported
_PATIENCE_S = 2.0  # without a command, after which it reports that it waits
_CALM_S = 1.0  # without a failure to send, after which it reports that frames are sent again
_ANGLE, _LEFT, _RIGHT = (COLUMN_PLACE[name] for name in ("gate_angle_deg", "left_current_a", "right_current_a"))


class Moment(NamedTuple):
    """State of a loop at one moment, as the progress monitor needs it."""

    tick: int  # since the scenario's time 0
    row: Any  # (ROW_WIDTH,) of the last tick
    sent: int  # frames
    overruns: int
    link: LinkCounts


class ProgressMonitor:
    """Reports a running loop's progress from its `reception`, which the loop writes in place.

    `events` returns what the ECU in this process has reported after the first so many events. The scenario's time
    0 is `ticks_before` ticks after the loop's. `apart` says how to keep the bus apart from another bench's,
    `within` why the ECU that is waited for cannot be reached, `why_full` why frames may find no room.
    """

    def __init__(
        self,
        rig: Rig,
        config: LoopConfig,
        reception: Reception,
        listener: Listener,
        events: Callable[[int], Sequence[Event]] = lambda since: (),
        clock: Callable[[], float] = time.monotonic,
        ticks_before: int = 0,
        apart: str = "",
        within: str = "",
        why_full: str = "",
    ) -> None:
        self._before = ticks_before
        self._config = config
        self._texts = RefusalTexts(rig, config, ticks_before * config.step)
        self._reception = reception
        self._listener = listener
        self._events = events
        self._clock = clock
        self._reported_events = 0
        self._listed_causes: set[int] = set()
        self._apart = f"; {apart}" if apart else ""
        self._within = f"; {within}" if within else ""
        self._why_full = f": {why_full}" if why_full else ""
        self._has_reported_another = False
        self._has_reported_gaps = False
        self._command = rig.command_message()
        self._row = self._texts.command_row
        self._next = 0.0
        self._last = -math.inf  # s, the time of the last look
        self._heard = math.inf  # when the command was last valid, or the time of the first look
        self._was_heard = False
        self._is_waiting = False
        self._has_named_foreign = False
        self._link = NO_ERRORS  # at the last look
        self._sent_until: LinkCounts | None = None  # counts before the frames that cannot be sent now; None: none
        self._failed = -math.inf  # when frames were last found unsent
        self._is_failure_reported = False

    def look(self, moment: Moment, is_last: bool = False) -> None:
        """Report to the listener what is new, at most every 0.1 s; with `is_last` at once, without a status."""
        now = self._clock()
        if now < self._next and not is_last:
            return
        self._next = now + _EVERY_S
        self._heard = min(self._heard, now)
        time_s = moment.tick * self._config.step
        for event in self._events(self._reported_events):
            if event.time > self._last and not is_last:  # the rows up to it are judged by the next look
                break
            self._reported_events += 1
            self._listener.happened(event.time, event.text)
        self._last = time_s
        for cause in REFUSED:
            if self._reception.refusals[cause].count and cause not in self._listed_causes:
                self._listed_causes.add(cause)
                self._listener.say(self._texts.of_first(self._reception.refusals, cause))
        if not is_last:
            self._look_for_another(time_s)
            self._look_for_gaps(time_s)
            self._look_at_command(time_s, now)
            self._look_at_sending(time_s, now, moment.link)
            self._listener.status(self._status(moment))

    def _look_for_another(self, time_s: float) -> None:
        """Report once that another gate is on the bus: a foreign frame was received that this gate sends."""
        if self._has_reported_another or not self._reception.refusals[FOREIGN].count:
            return
        seen = self._reception.foreign
        for identifier, name in self._texts.sent.items():
            if seen[slot_of(identifier)] == identifier:
                self._has_reported_another = True
                self._listener.say(
                    f"{time_s:.3f} s: received {name} ({identifier_text(identifier)}), which this gate sends: "
                    f"{ANOTHER}{self._apart}"
                )
                return

    def _look_for_gaps(self, time_s: float) -> None:
        """Report once that many command frames are missing by their counter; some may be rejected frames."""
        missing, cycles = missing_of(self._reception, self._row)
        if not self._has_reported_gaps and cycles > _MANY and missing > _MISSING * cycles:
            self._has_reported_gaps = True
            self._listener.say(f"{time_s:.3f} s: {gaps_text(missing, cycles, self._command)}")

    def _look_at_command(self, time_s: float, now: float) -> None:
        """Report when the command arrives or times out and, if missing for long, which message is awaited."""
        if self._reception.seen_ns[self._row] >= 0:
            if self._is_waiting:
                self._listener.say(f"{time_s:.3f} s: {self._command} received")
            self._heard, self._was_heard, self._is_waiting = now, True, False
        elif self._was_heard:
            self._listener.say(f"{time_s:.3f} s: {self._command} timed out: motors off")
            self._was_heard, self._is_waiting = False, True
        elif not self._is_waiting and now - self._heard > _PATIENCE_S:
            foreign = self._foreign()
            heard = f"; {foreign}" if foreign else self._within
            self._listener.say(f"{time_s:.3f} s: waits for {self._texts.awaited()}, motors off{heard}")
            self._is_waiting, self._has_named_foreign = True, bool(foreign)
        elif self._is_waiting and not self._has_named_foreign and not self._reception.refusals[ACCEPTED].count:
            foreign = self._foreign()
            if foreign:
                self._listener.say(f"{time_s:.3f} s: {foreign}; waits for {self._texts.awaited()}")
                self._has_named_foreign = True

    def _look_at_sending(self, time_s: float, now: float, link: LinkCounts) -> None:
        """Report when frames cannot be sent, other than because of a lost link, and when sending works again."""
        before, self._link = self._link, link
        if link.send_failures > before.send_failures:
            self._failed = now
            if self._sent_until is None:  # reported with the next look: a lost link, too, is told only then
                self._sent_until, self._is_failure_reported = before, False
                return
        since = self._sent_until
        if since is None:
            return
        if not self._is_failure_reported and link.losses == since.losses:
            is_full = link.send_queue_full > since.send_queue_full
            self._listener.say(f"{time_s:.3f} s: frames cannot be sent{self._why_full if is_full else ''}")
            self._is_failure_reported = True
        if now - self._failed > _CALM_S:
            if self._is_failure_reported:
                missing = link.send_failures - since.send_failures
                self._listener.say(f"{time_s:.3f} s: frames are sent again; {missing} were not sent")
            self._sent_until = None

    def _foreign(self) -> str:
        """Return text on the first foreign frame; "": none, a test bench's, or another gate was reported."""
        first = self._texts.first_foreign(self._reception.refusals)
        if not first or self._has_reported_another:
            return ""
        remedy = "" if ANOTHER in first else "; check that `rig` is that of the ECU"
        return f"{first} is on the bus, but not received by this rig{remedy}{self._apart}"

    def _status(self, moment: Moment) -> RunStatus:
        """Return the run's status for the listener."""
        counts = self._reception.refusals["count"]
        seen_ns = int(self._reception.seen_ns[self._row])
        now_s = (moment.tick + self._before) * self._config.step
        age = now_s - seen_ns * 1e-9 if seen_ns >= 0 else None
        return RunStatus(
            time_s=moment.tick * self._config.step,
            angle_deg=float(moment.row[_ANGLE]),
            left_current_a=float(moment.row[_LEFT]),
            right_current_a=float(moment.row[_RIGHT]),
            command_age_s=age,
            sent=moment.sent,
            accepted=int(counts[ACCEPTED]),
            rejected=sum(int(counts[cause]) for cause in REFUSED),
            foreign=int(counts[FOREIGN]),
            overruns=moment.overruns,
            unsent=moment.link.send_failures,
        )

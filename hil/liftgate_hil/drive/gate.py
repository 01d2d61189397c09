"""A gate that the caller steps: in this process, without a bus, at the caller's own pace.

with Gate(vehicle="suv", rig="liftgate", initial="closed", seed=1) as gate:
    gate.command(left_duty=60, right_duty=60, direction="open", latch_release=True)
    frames = gate.step(0.010)              # list[can.Message] that the gate sent meanwhile
    gate.truth["gate_angle_deg"], gate.sensed["left_current_a"]
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.codec.frames import with_frame_flags
from liftgate_hil.config.described import value_of
from liftgate_hil.config.restbus import value_in
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.scenario_tables import Fault, fault_of
from liftgate_hil.config.shipped import DEFAULT_RIG, DEFAULT_VEHICLE
from liftgate_hil.config.toml import show
from liftgate_hil.diagnostics import services
from liftgate_hil.diagnostics.tester import (
    CallerLoop,
    Diagnostics,
    Tester,
    clear_codes,
    is_asking_once,
    read_codes,
)
from liftgate_hil.ecu import wire
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_hil.formats.edges import DRIVES, Edge, edges_since
from liftgate_hil.loop.episode import Episode
from liftgate_hil.loop.rings import Memory
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.operate.by_hand import held_obstacle, obstacle_in, surroundings_in
from liftgate_hil.operate.cyclic_command import CyclicCommand
from liftgate_hil.operate.loop_target import LoopTarget
from liftgate_hil.operate.orders import Orders
from liftgate_hil.plan.plan import loop_start_of
from liftgate_hil.plan.request import DEFAULT_RATE, RATE
from liftgate_hil.plan.setup import rig_of, setup_of, variant_of
from liftgate_hil.plan.stimulation import opening_of
from liftgate_hil.signals import COLUMN_PLACE, SENSED_PREFIX, ColumnValues, columns_of
from liftgate_hil.stimuli.moments import Instant
from liftgate_hil.stimuli.restbus import BENCH, OPERATOR, start_value_of
from liftgate_hil.stimuli.stimulus_plan import take_posted
from liftgate_plant.edge_ring import RING_SIZE
from liftgate_plant.obstacle import ROD_STIFFNESS
from liftgate_plant.vehicle import Vehicle

if TYPE_CHECKING:
    import can

_ROWS, _FRAMES = 1024, 8192  # of the rings; frames for twice what a tick may bring


class Gate:
    """Simulated gate and rig, stepped by the caller: commands and frames in; frames, true and sensed values out.

    `vehicle` and `rig` are shipped names, files or objects; `settings` (KEY=VALUE) replace the vehicle's keys;
    `draw` and `ideal` select the variant of the vehicle file, see `load_vehicle`; `initial` is "closed" (latched),
    "open" or an angle in degrees; `rate` [Hz] is that of the ticks. Not thread-safe. Raises ConfigError.
    """

    def __init__(
        self,
        vehicle: str | Path | Vehicle = DEFAULT_VEHICLE,
        rig: str | Path | Rig = DEFAULT_RIG,
        initial: str | float = "closed",
        seed: int = 0,
        rate: float = DEFAULT_RATE,
        settings: Sequence[str] = (),
        draw: int | None = None,
        ideal: bool = False,
    ) -> None:
        variant = variant_of(draw, ideal)
        setup = setup_of(vehicle=vehicle, settings=settings, initial=initial, seed=seed, variant=variant)
        self.rig = rig = rig_of(rig)
        self._vehicle = vehicle = setup.vehicle
        opening = opening_of(rig, has_operator=True)
        start = loop_start_of(setup, rig, value_of("rate", rate, RATE), opening, RING_SIZE)
        self._config = start.config
        target = LoopTarget(
            start.stimuli, setup, rig, opening.signals, restart=_cannot_reset, make_room=self._make_room
        )
        self._orders = Orders(rig, target.layer(BENCH))
        self._target = target.layer(OPERATOR)
        self._faults: list[InjectedFault] = []
        self._signals: set[str] = set()  # of the restbus, set by `signal`
        self._memory = Memory(_ROWS, _FRAMES)
        self._is_closed = False
        self._bus = Adapter(rig, vehicle.drives)
        self._command = CyclicCommand(rig, self._config, self._bus.node.reference)
        self._episode = Episode(start, self._bus, [_StepSink(self)], memory=self._memory, edges=RING_SIZE // 2)
        self._row = np.full(len(COLUMN_PLACE), np.nan)
        self._waiting: list[tuple[int, int, bytes]] = []
        self._sent: list[can.Message] = []  # in this step, as are the edges
        self._edges: list[Edge] = []
        self._edges_seen = 0

    def __enter__(self) -> Gate:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the gate's memory; closing it once more does nothing.

        What it has seen can still be read; stepping and commanding it raise ConfigError.
        """
        if not self._is_closed:
            self._is_closed = True
            self._memory.close()

    def _check_open(self) -> None:
        if self._is_closed:
            raise ConfigError("this gate is closed; allowed: another Gate")

    @property
    def time(self) -> float:
        """Model time [s]."""
        return self._episode.time

    @property
    def truth(self) -> ColumnValues:
        """True values, by the names of recording columns; empty before the first step."""
        return self._columns("")

    @property
    def sensed(self) -> ColumnValues:
        """Sensed values, by the names of recording columns without `sensed_`; empty before the first step."""
        return self._columns(SENSED_PREFIX)

    def _columns(self, prefix: str) -> ColumnValues:
        """Return the values of the last row whose names begin with `prefix`, without it; "": the true values."""
        if self._episode.ticks == 0:
            return ColumnValues()
        columns = columns_of(self._vehicle.drives)
        names = [name for name in columns if name.startswith(SENSED_PREFIX) == bool(prefix)]
        return ColumnValues({name.removeprefix(prefix): float(self._row[COLUMN_PLACE[name]]) for name in names})

    @property
    def summary(self) -> Summary:
        """Figures of all frames so far."""
        loop = self._episode.state
        return Summary(
            clock="lockstep",
            ticks=loop.tick,
            model_time_s=self.time,
            frames_sent=int(self._memory.shared.control.sent[0]),
            command_timeouts=loop.timeouts,
            received=loop.counts,
            injections=self._orders.count,
            injected=list(self._orders.done),
            injections_refused=self._orders.refused,
        )

    def command(self, command: None = None, /, **quantities: float | str | bool) -> None:
        """Send a command every command cycle from now on, through rig and codec, with counter and checksum.

        Its quantities are `left_duty`, `right_duty` [%], `left_direction`, `right_direction` or `direction` for
        both (coast, open, close, brake), and `latch_release`; `latch_cinch` is sent where it is named. What is not
        named is 0 (coast). `command()` and `command(None)` stop sending.

        Raises ConfigError.
        """
        self._check_open()
        if command is not None:
            raise ConfigError(f"`command` {show(command)}: allowed: None, or quantities by their names")
        if quantities:
            self._command.change(quantities)
        else:
            self._command.silence()

    def send(self, message: can.Message) -> None:
        """Queue a frame that the gate reads in the next tick. Raises ConfigError."""
        from liftgate_hil.transport.messages import NotAFrameError, fields_of

        self._check_open()
        try:
            identifier, length, flags, data = fields_of(message)
        except NotAFrameError as error:
            raise ConfigError(f"`send` {error}") from error
        self._waiting.append((with_frame_flags(identifier, flags), length, data))

    def set(self, **surroundings: float | None) -> None:
        """Set surroundings from the next tick on.

        Examples: `road_slope_deg=8`, `supply_voltage_v`, `hand_force_n`. Switches (`handle_pulled`) take True and
        False; None clears. Raises ConfigError.
        """
        self._check_open()
        self._target.hold(surroundings_in(surroundings))

    def obstacle(
        self,
        angle_deg: float,
        stiffness: float = ROD_STIFFNESS,
        distance: float | None = None,
        damping: float = 0.0,
        gap: float = 0.0,
        meets: str = "closing",
        lateral: float = 0.0,
    ) -> None:
        """Put a body (N/m, N s/m) in the gate's way, replacing an earlier one; `meets`: "closing" or "opening".

        It is at an angle [deg], a distance [m] from the hinge (default: the gate's edge) and a lateral position
        [m] (positive to the left).

        Raises ConfigError.
        """
        self._check_open()
        given = {
            "angle_deg": angle_deg,
            "stiffness": stiffness,
            "distance": distance,
            "damping": damping,
            "gap": gap,
            "meets": meets,
            "lateral": lateral,
        }
        self._target.hold(held_obstacle(obstacle_in(given, self._vehicle.gate.length)))

    def clear_obstacle(self) -> None:
        """Remove the obstacle."""
        self._check_open()
        self._target.hold(held_obstacle(None))

    def _make_room(self) -> None:
        """Apply the surroundings, faults and signals queued for the next tick, so that the queue has room."""
        take_posted(self._episode.stimuli, self.time)

    def signal(self, name: str, value: float | str | None) -> None:
        """Set a signal that another control unit sends, from now on.

        `name` is `MESSAGE.SIGNAL` of the rig's database, `value` is in its unit or one of its labels. The message
        is sent in its cycle, with counter and protection; its other signals have their start values. None: the
        signal has its start value again.

        Raises ConfigError.
        """
        self._check_open()
        issues = ConfigIssues("`signal`")
        tables, number = self.rig.tables, None
        if value is not None or name not in self._signals:
            number = value_in("", str(name), value, tables, self.rig.mapped, issues)
        issues.raise_if_any()
        rest = start_value_of(tables.messages, name)
        self._target.set_signals({name: math.nan if number is None else number}, rest=rest)
        self._signals.add(name)

    def fault(self, kind: str, where: str | None = None, *, seed: int = 0, **values: Any) -> InjectedFault:
        """Inject a fault from the next tick on; the returned object has `clear()`, which ends it.

        `kind` is one of docs/scenario.md, `where` names the drive (`left`, `right`, `both`) or the message, and
        `values` are the kind's own: `gate.fault("hall_a_stuck", where="left", value=0)`. Up to 32 faults may be in
        force at a time, with those that frames of a test bench inject.

        Raises ConfigError.
        """
        self._check_open()
        fault = replace(fault_of(kind, where, {"seed": seed, **values}), start=Instant(self.time))
        made = InjectedFault(self, fault)
        self._inject([*self._faults, made])
        return made

    def _inject(self, faults: list[InjectedFault]) -> None:
        """Set the faults that the caller has injected. Raises ConfigError, and changes nothing then."""
        self._target.inject([each.fault for each in faults])
        self._faults = faults

    def _clear(self, fault: InjectedFault) -> None:
        self._inject([each for each in self._faults if each is not fault])

    def read_dtcs(self, cycle: Callable[[], object]) -> dict[str, int]:
        """Read the trouble codes of the ECU under test: the status byte (ISO 14229-1) of each by its text.

        An example is {"B1A01-62": 0x2F}. A tester beside the gate reads them as the rig's `[diagnostics]` says:
        UDS ReadDTCInformation, reportDTCByStatusMask with `status_mask`.

        `cycle` runs once through the caller's loop: the gate steps, the ECU gets what gate and tester have sent,
        and what it sends goes to the gate. It is called, without arguments, until the ECU has answered::

            def cycle():
                for message in ecu.step(gate.time, gate.step(0.010)):
                    gate.send(message)

            gate.clear_dtcs(cycle)
            gate.fault("hall_a_stuck", where="left", value=0)
            for _ in range(300):
                cycle()
            assert "B1A01-62" in gate.read_dtcs(cycle)

        Raises DiagnosticsError where the ECU refuses the request, with its `nrc`, or does not answer within
        `timeout_ms` (5 s after "response pending", 60 s at most); ConfigError where the rig has no `[diagnostics]`
        or `cycle` does not step this gate; and what `cycle` raises.
        """
        return read_codes(*self._to_be_asked("read_dtcs", cycle))

    def clear_dtcs(self, cycle: Callable[[], object]) -> None:
        """Clear all trouble codes of the ECU under test: UDS ClearDiagnosticInformation of all groups.

        `cycle` and what is raised are as with `read_dtcs`.
        """
        clear_codes(*self._to_be_asked("clear_dtcs", cycle))

    def _to_be_asked(self, name: str, cycle: Callable[[], object]) -> tuple[Diagnostics, CallerLoop]:
        """Return the rig's diagnostics, and `cycle` as a tester's loop; `name` for errors. Raises ConfigError."""
        self._check_open()
        own = self.rig.diagnostics
        if own is None:
            text = "has no [diagnostics]; allowed: a rig with [diagnostics] request and response"
            raise ConfigError(f"`{name}`: the rig {self.rig.source} {text}")
        if not services.is_there():
            raise ConfigError(f"`{name}`: trouble codes {services.MISSING}")
        if not callable(cycle):
            raise ConfigError(f"`cycle` {show(cycle)}: allowed: a function without arguments")
        if is_asking_once(self._episode.stimuli.tester):
            raise ConfigError(f"`{name}`: the tester waits for a response; allowed: after that")
        return own, CallerLoop(self._put_tester, cycle, lambda: self.time)

    def _put_tester(self, tester: Tester) -> None:
        self._episode.follow(self._episode.stimuli._replace(tester=tester))

    def step(self, seconds: float) -> list[can.Message]:
        """Advance by a time [s], rounded to ticks, at least one; return the frames that the gate sent meanwhile.

        Raises PlantDivergedError, ConfigError.
        """
        self._check_open()
        if not isinstance(seconds, Real) or isinstance(seconds, bool) or not 0.0 < seconds <= 1e6:
            raise ConfigError(f"`seconds` {show(seconds)}: allowed: above 0, up to 1e6 s")
        end = self._episode.ticks + max(1, round(seconds / self._config.step))
        self._sent, self._edges = [], []
        while self._episode.ticks < end:
            stop = self._next_stop(end)
            self._waiting += self._command.frames_at(self._episode.ticks)
            given, self._waiting = self._waiting[: wire.CAPACITY], self._waiting[wire.CAPACITY :]
            self._episode.give(given)
            self._episode.run(stop)
        return self._sent

    def _note(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Store a step part's last row, sent frames and Hall edges; execute a bench's orders in its frames."""
        from liftgate_hil.transport.messages import logged_message

        self._row[:] = rows[-1]
        self._sent += map(logged_message, frames[frames.is_sent != 0])
        self._orders.look(frames, self.time)
        edges = self._episode.state.sensors.edges
        self._edges += edges_since(edges, self._edges_seen)
        self._edges_seen = int(edges.written[0])

    def edges(self, drive: str) -> list[Edge]:
        """Return the Hall edges of a drive, `left` or `right`, during the last `step`, in the order of time.

        Raises ConfigError.
        """
        drives = DRIVES[: self._vehicle.drives]
        if drive not in drives:
            raise ConfigError(f"`edges` {show(drive)}: allowed: {', '.join(drives)}")
        return [edge for edge in self._edges if edge.drive == drive]

    def _next_stop(self, end: int) -> int:
        """Return the tick up to which the gate can run without interruption, at most `end`."""
        tick = self._episode.ticks
        is_ordered = any(self._orders.is_one(identifier) for identifier, _, _ in self._waiting)
        if len(self._waiting) > wire.CAPACITY or is_ordered:
            return tick + 1
        if math.isfinite(release := self._orders.next_release):
            end = min(end, max(tick + 1, math.ceil(release / self._config.step - 1e-6)))
        if not self._command.is_on:
            return min(end, tick + _ROWS)
        cycle = self._command.cycle
        return min(end, (tick // cycle + 1) * cycle, tick + _ROWS)


class _StepSink:
    """Sink that passes the rows and frames of a step to its gate."""

    def __init__(self, gate: Gate) -> None:
        self._gate = gate

    def take(self, rows: NDArray[np.float64], frames: Any) -> None:
        """Pass rows and frames on to the gate."""
        self._gate._note(rows, frames)


def _cannot_reset() -> None:
    """Raise ConfigError: the ECU of a gate that the caller steps belongs to the caller."""
    raise ConfigError("request reset; allowed with [reset] signal: this gate's ECU is the caller's")


class InjectedFault:
    """A fault injected into a gate, in force until it is cleared."""

    def __init__(self, gate: Gate, fault: Fault) -> None:
        self._gate = gate
        self.fault = fault

    def clear(self) -> None:
        """End the fault from the next tick on; further calls do nothing."""
        self._gate._clear(self)

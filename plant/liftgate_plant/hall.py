"""Hall sensors A and B on the motor's shaft, and how an ECU's timer and decoder evaluate their edges.

    shaft → magnet wheel → square waves of A and B → quadrature decoder → count → speed
                                                   → capture of each edge's time → period

One electrical turn, a pair of poles, is four edges: A rises, B rises, A falls, B falls while the gate opens.
Faults act between the waves and the decoder. Edges lie half a step beside whole steps, or where the magnet wheel
and the two sensors place them. Within a tick the shaft moves as in the solver, with a linearly changing speed, so
that an edge's time is the root of a quadratic: the edges are the same, whatever the tick.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from liftgate_compiler import compilable, outlined
from liftgate_plant.edge_ring import MOST_EDGES, EdgeRing, write_edge
from liftgate_plant.faults import HallFault
from liftgate_plant.noise import gaussian, uniform

LEFT, RIGHT = 0, 1
A, B = 0, 1

_EDGES_OF_A_TURN = 4
_FARTHEST = 1e12  # steps; positions beyond it are ignored, so that counts fit into 64 bits
MOST_DISPLACED = 0.45  # steps; edges displaced farther would overtake each other
_JITTER, _PITCH, _MISSING, _EXTRA = 8, 10, 16, 18  # channels of the noise, plus the drive's number


class Encoder(NamedTuple):
    """A magnet wheel with two Hall sensors; lengths in steps, four to an electrical turn."""

    counts: float  # steps per motor revolution
    pitch: float  # σ of the boundary between two poles
    phase: float  # lag of B beyond its nominal place behind A
    high: float  # excess length of the high part of both waves over half
    hysteresis: float  # distance between the edges of both directions
    jitter: float  # σ of every single edge
    wheel: int  # number of the individual wheel, which determines its poles
    is_ideal: bool


class MotorShaft(NamedTuple):
    """Position [rev] and speed [rev/s] of a motor's shaft."""

    position: float
    speed: float


class Tick(NamedTuple):
    """Time of a reading: begin [s] and length [s] of the tick, and the seed of random errors."""

    begin: float
    length: float
    seed: int
    is_sample: bool  # whether a sample period of the Hall speed ends with this tick
    number: int = 0  # of the tick; the first one is 1


# Hall sensors of one drive: state of the decoder, and what an ECU's timer has captured. Written in place, so
# that a tick without an edge touches almost nothing.
HALL = np.dtype(
    [
        ("position", "f8"),  # rev, of the shaft at the last reading
        ("motor_speed", "f8"),  # rev/s, at the last reading
        ("step", "i8"),  # position of the magnet wheel, in steps of the square waves
        ("a", "i8"),  # the levels that the decoder saw last
        ("b", "i8"),
        ("count", "i8"),  # count of the decoder
        ("sampled", "i8"),  # the count at the start of the present sample period
        ("speed", "i8"),  # counts in the last sample period
        ("edges", "i8"),  # number of edges so far
        ("run", "i8"),  # number of consecutive edges in one direction, with its sign
        ("last", "f8"),  # s, model times of the last four edges, the newest first
        ("second", "f8"),
        ("third", "f8"),
        ("fourth", "f8"),
        ("period", "f8"),  # s, of the last full electrical turn; 0: none yet
        ("period_speed", "f8"),  # rev/s, by this period
        ("wiring", "i8"),  # code of stuck and swapped sensors; 0: none
        ("drawn", "i8"),  # number of random numbers drawn for missing and extra edges
    ]
)


class Leg(NamedTuple):
    """Part of a tick in which the shaft turns in one direction; positions in steps, times in s in the tick."""

    start: float
    end: float
    start_time: float
    end_time: float


class Path(NamedTuple):
    """Motion of the shaft over a tick: start + speed t + ½ acceleration t²; in steps and s."""

    start: float
    speed: float
    acceleration: float


@compilable
def ideal_count(counts: float, position: float) -> int:
    """Return the count of a perfect encoder at a motor position [rev].

    Its edges lie half a count beside whole positions.
    """
    return math.floor(position * counts + 0.5)


@compilable
def hall_levels(step: int) -> tuple[int, int]:
    """Return Hall A and B (0 or 1) at a step of the shaft: Gray code, A leads B while opening."""
    phase = step % _EDGES_OF_A_TURN
    return (1 if 1 <= phase <= 2 else 0), (1 if phase >= 2 else 0)


@compilable
def decoded(before_a: int, before_b: int, a: int, b: int) -> int:
    """Return the count of a quadrature decoder for a change of levels: 1, −1, or 0 for none or both."""
    phase_before = 2 * before_b + (before_a ^ before_b)
    phase = 2 * b + (a ^ b)
    way = (phase - phase_before) % 4
    if way == 1:
        return 1
    return -1 if way == 3 else 0


@compilable
def displacement(encoder: Encoder, edge: int, way: int, drive: int, seed: int, edges: int) -> float:
    """Return the displacement [steps] of the edge between `edge` and the next step from its nominal place.

    `way` is the direction in which the shaft turns (1 opens, −1 closes).
    """
    if encoder.is_ideal:
        return 0.0
    channel, boundary = edge % 2, edge // 2
    moved = 0.0
    if encoder.pitch > 0.0:
        poles = max(1, round(0.5 * encoder.counts))
        moved += encoder.pitch * gaussian(encoder.wheel, boundary % poles, _PITCH + drive)
    if channel == B:
        moved += encoder.phase
    moved += 0.5 * encoder.high if boundary % 2 == 1 else -0.5 * encoder.high  # rises earlier, falls later
    moved += 0.5 * encoder.hysteresis * way
    if encoder.jitter > 0.0:
        moved += encoder.jitter * gaussian(seed, edges, _JITTER + drive)
    return min(max(moved, -MOST_DISPLACED), MOST_DISPLACED)


def farthest(encoder: Encoder) -> float:
    """Return the largest displacement [steps] of any edge, with random parts taken at 3 σ."""
    fixed = abs(encoder.phase) + 0.5 * abs(encoder.high) + 0.5 * encoder.hysteresis
    return fixed + 3.0 * math.hypot(encoder.pitch, encoder.jitter)


@compilable
def capture(hall: Any, counts: float, way: int, time: float) -> None:
    """Process an edge at `time` [s] in the capture timer of a HALL row; `counts` edges make a revolution.

    A period is reported once five edges came in one direction.
    """
    hall.edges += 1
    hall.run = hall.run + way if hall.run * way > 0 else way
    if abs(hall.run) > _EDGES_OF_A_TURN:
        hall.period = time - hall.fourth
        if hall.period > 0.0:
            hall.period_speed = _EDGES_OF_A_TURN / (counts * hall.period)
    hall.period_speed = math.copysign(hall.period_speed, float(way))
    hall.fourth, hall.third, hall.second, hall.last = hall.third, hall.second, hall.last, time


@compilable
def period_speed(hall: Any, now: float) -> float:
    """Return the shaft's speed [rev/s] by the duration of the last full electrical turn.

    If at `now` [s] more time than that turn took has passed since the last edge, this time replaces the turn's.
    """
    age = now - hall.last
    if age <= hall.period or hall.period == 0.0:
        return float(hall.period_speed)
    return float(hall.period_speed * hall.period / age)


@compilable
def note_edge(ring: EdgeRing, time: float, drive: int, edge: int, way: int) -> None:
    """Write an edge of the magnet wheel into the ring buffer."""
    rises = 1 if edge % _EDGES_OF_A_TURN < 2 else 0
    write_edge(ring, time, drive, edge % 2, rises if way > 0 else 1 - rises)


@compilable
def wire_levels(fault: HallFault, step: int) -> tuple[int, int]:
    """Return the levels on the wires of sensors A and B at a step of the shaft, under a fault."""
    a, b = hall_levels(step)
    if not np.isnan(fault.level_a):
        a = int(fault.level_a)
    if not np.isnan(fault.level_b):
        b = int(fault.level_b)
    return (b, a) if fault.swapped != 0.0 else (a, b)


@compilable
def wiring_of(fault: HallFault) -> int:
    """Return a code number for the wire levels' part of a fault (stuck, swapped); 0: no such fault."""
    wiring = 0 if np.isnan(fault.level_a) else 1 + int(fault.level_a)
    wiring += 0 if np.isnan(fault.level_b) else 3 + 3 * int(fault.level_b)
    return wiring + (9 if fault.swapped != 0.0 else 0)


@outlined
def see(hall: Any, counts: float, channel: int, a: int, b: int, time: float, drive: int, ring: EdgeRing) -> None:
    """Process an edge on a sensor's wire at `time` [s], with new levels `a`, `b`, in decoder, timer and ring.

    Where both levels have changed since the last edge, the decoder counts none.
    """
    if a == hall.a and b == hall.b:
        return
    way = decoded(hall.a, hall.b, a, b)
    hall.count += way
    along = way
    if way == 0:
        along = 1 if hall.run >= 0 else -1
    capture(hall, counts, along, time)
    write_edge(ring, time, drive, channel, a if channel == A else b)
    hall.a, hall.b = a, b


@outlined
def extra_edges(fault: HallFault, hall: Any, counts: float, tick: Tick, drive: int, ring: EdgeRing) -> None:
    """Process a tick's spurious edges, at the mean rate of the fault, as `see` does."""
    count = fault.extra * tick.length
    drawn = uniform(tick.seed ^ int(fault.seed), hall.drawn, _EXTRA + drive)
    edges = int(count + drawn)
    for k in range(edges):
        hall.drawn += 1
        a, b, channel = hall.a, hall.b, A
        if uniform(tick.seed ^ int(fault.seed), hall.drawn, _EXTRA + drive) < 0.5:
            a = 1 - a
        else:
            b, channel = 1 - b, B
        # Spread over the rest of the tick after the shaft's own edges.
        last, end = max(float(hall.last), tick.begin), tick.begin + tick.length
        see(hall, counts, channel, a, b, last + (end - last) / (edges - k + 1), drive, ring)
    hall.drawn += 1


@compilable
def path_of(encoder: Encoder, before: MotorShaft, now: MotorShaft, length: float) -> Path:
    """Return a shaft's motion, in encoder steps, fitted to its states before and after a time `length` [s].

    It fits both positions and the change of speed. The speed is taken as constant where the fit would turn back
    although both speeds have the same direction, such as for a shaft that stops early in the tick.
    """
    start, end = before.position * encoder.counts + 0.5, now.position * encoder.counts + 0.5
    per_length = 1.0 / length
    acceleration = (now.speed - before.speed) * encoder.counts * per_length
    speed = (end - start) * per_length - 0.5 * acceleration * length
    turns = speed * (speed + acceleration * length) < 0.0
    if turns and before.speed * now.speed >= 0.0:
        return Path(start, (end - start) * per_length, 0.0)
    return Path(start, speed, acceleration)


@compilable
def crossing(path: Path, leg: Leg, place: float) -> float:
    """Return the time [s since the tick's begin] at which the shaft passes an edge within a leg."""
    way = place - path.start
    root = math.sqrt(max(0.0, path.speed * path.speed + 2.0 * path.acceleration * way))
    final = root if leg.end > leg.start else -root
    # Of the two forms of the root, the one without cancellation.
    if path.speed * final >= 0.0:
        below = path.speed + final
        time = 2.0 * way / below if below != 0.0 else leg.start_time
    else:
        time = (final - path.speed) / path.acceleration
    return min(max(time, leg.start_time), leg.end_time)


@compilable
def along(
    encoder: Encoder, fault: HallFault, hall: Any, path: Path, leg: Leg, tick: Tick, drive: int, ring: EdgeRing
) -> None:
    """Advance the Hall sensors to the end of a leg, with its edges processed one after the other."""
    way = 1 if leg.end > leg.start else -1
    while True:
        edge = int(hall.step) if way > 0 else int(hall.step) - 1
        place = edge + 1.0
        place += displacement(encoder, edge, way, drive, tick.seed, int(hall.edges))
        if (leg.end < place) if way > 0 else (leg.end >= place):
            break
        hall.step += way
        time = tick.begin + crossing(path, leg, place)
        if fault.is_on != 0.0:
            hall.drawn += 1
            drawn = uniform(tick.seed ^ int(fault.seed), hall.drawn, _MISSING + drive)
            if drawn >= fault.missing:
                a, b = wire_levels(fault, hall.step)
                wire = 1 - edge % 2 if fault.swapped != 0.0 else edge % 2
                see(hall, encoder.counts, wire, a, b, time, drive, ring)
            continue
        a, b = hall_levels(hall.step)
        hall.count += decoded(hall.a, hall.b, a, b)
        hall.a, hall.b = a, b
        capture(hall, encoder.counts, way, time)
        note_edge(ring, time, drive, edge, way)


@compilable
def move(
    encoder: Encoder, fault: HallFault, hall: Any, now: MotorShaft, tick: Tick, drive: int, ring: EdgeRing
) -> None:
    """Advance the Hall sensors along the shaft's motion over a tick, in which it may reverse once."""
    end = now.position * encoder.counts + 0.5
    if encoder.is_ideal and hall.step <= end < hall.step + 1.0 and hall.motor_speed * now.speed >= 0.0:
        return
    path = path_of(encoder, MotorShaft(hall.position, hall.motor_speed), now, tick.length)
    if abs(end - path.start) > MOST_EDGES:  # too far for a motor: the state was set, or has diverged
        step = math.floor(end)
        hall.count += step - hall.step
        hall.edges += abs(step - hall.step)
        hall.run, hall.period, hall.period_speed = 0, 0.0, 0.0
        hall.last = tick.begin + tick.length
        hall.step = step
        hall.a, hall.b = wire_levels(fault, step)
        return
    turn = tick.length
    if path.speed * (path.speed + path.acceleration * tick.length) < 0.0:
        turn = min(-path.speed / path.acceleration, tick.length)
    at, time = path.start, 0.0
    while time < tick.length:
        is_last = time > 0.0 or turn >= tick.length
        until = tick.length if is_last else turn
        leg = Leg(at, end if is_last else at + 0.5 * path.speed * turn, time, until)
        if leg.end != leg.start:
            along(encoder, fault, hall, path, leg, tick, drive, ring)
        at, time = leg.end, until


@compilable
def read_hall(
    encoder: Encoder, fault: HallFault, halls: Any, now: MotorShaft, tick: Tick, drive: int, ring: EdgeRing
) -> None:
    """Advance one drive's Hall sensors, a row of (2,) HALL, to the end of a tick.

    At the end of a sample period the speed is the number of counts during it.
    """
    hall = halls[drive]
    if fault.is_on != 0.0 or hall.wiring != 0:
        wiring = wiring_of(fault)
        if wiring != hall.wiring:  # a fault that begins or ends changes the levels on the wires
            hall.wiring = wiring
            a, b = wire_levels(fault, hall.step)
            see(hall, encoder.counts, A, a, hall.b, tick.begin, drive, ring)
            see(hall, encoder.counts, B, hall.a, b, tick.begin, drive, ring)
    if abs(now.position * encoder.counts) < _FARTHEST:
        move(encoder, fault, hall, now, tick, drive, ring)
        hall.position, hall.motor_speed = now.position, now.speed
    if fault.extra > 0.0:
        extra_edges(fault, hall, encoder.counts, tick, drive, ring)
    if tick.is_sample:
        hall.speed = hall.count - hall.sampled
        hall.sampled = hall.count


def initial_halls(encoder: Encoder, left: MotorShaft, right: MotorShaft) -> Any:
    """Return the initial states (2,) HALL of both drives' Hall sensors, with counts that match the shafts.

    A count is that of a decoder that was 0 at position 0.
    """
    halls = np.zeros(2, dtype=HALL)
    for drive, (hall, shaft) in enumerate(zip(halls, (left, right), strict=True)):
        count = _first_step(encoder, shaft.position, drive)
        hall["step"] = hall["count"] = hall["sampled"] = count
        hall["a"], hall["b"] = hall_levels(count)
        hall["position"], hall["motor_speed"] = shaft.position, shaft.speed
    return halls.view(np.recarray)


def _first_step(encoder: Encoder, position: float, drive: int) -> int:
    """Return the encoder's step at a shaft's `position` [rev], by the displaced edges.

    Where the edges of both directions differ, the last motion is assumed to have been in opening direction. Jitter
    is left out, as it belongs to edges still to come.
    """
    still = encoder._replace(jitter=0.0)
    step, place = ideal_count(encoder.counts, position), position * encoder.counts + 0.5
    if place >= step + 1.0 + displacement(still, step, 1, drive, 0, 0):
        return step + 1
    return step - 1 if place < step + displacement(still, step - 1, 1, drive, 0, 0) else step

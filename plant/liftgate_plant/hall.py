"""Hall sensors A and B on the motor's shaft, and what an ECU's timer and decoder make of their edges.

    shaft → magnet wheel → square waves of A and B → quadrature decoder → count → speed
                                                   → capture of each edge's time → period

One electrical turn, a pair of poles, is four edges: A rises, B rises, A falls, B falls while the gate opens.
Edges lie half a step beside whole ones, or where the magnet wheel and the two sensors have them. Within a tick the
shaft moves as the solver has it, its speed on a straight line, so that an edge's time is the root of a quadratic:
the same edges, whatever the tick.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_plant.compiler import compilable
from liftgate_plant.noise import gaussian

LEFT, RIGHT = 0, 1
A, B = 0, 1

EDGE = np.dtype(
    [
        ("time_s", "f8"),  # model time
        ("drive", "i8"),  # LEFT, RIGHT
        ("channel", "i8"),  # A, B
        ("level", "i8"),  # after the edge
    ]
)

_EDGES_OF_A_TURN = 4
_MOST_EDGES = 20_000  # of a drive in a tick
_FARTHEST = 1e12  # steps; a count beyond it does not fit into 64 bits
_MOST_DISPLACED = 0.45  # steps; edges farther out would overtake each other
_JITTER, _PITCH = 8, 10  # channels of the noise, + drive


class Encoder(NamedTuple):
    """A magnet wheel with its two sensors; lengths in steps, of which an electrical turn has four."""

    counts: float  # steps per motor revolution
    pitch: float  # σ of where the boundary between two poles is
    phase: float  # by how much B lags its place behind A
    high: float  # by how much the high part of both waves is longer than half
    hysteresis: float  # width between the edges of one way and of the other
    jitter: float  # σ of every single edge
    wheel: int  # which wheel of the production: another one has other poles
    is_ideal: bool


class Shaft(NamedTuple):
    """Where a motor's shaft is [rev] and how fast it turns [rev/s]."""

    position: float
    speed: float


class Tick(NamedTuple):
    """A reading's time: the tick's begin [s] and length [s], and what its random errors are drawn from."""

    begin: float
    length: float
    seed: int
    is_sample: bool  # a sample period of the Hall speed ends with it


class EdgeRing(NamedTuple):
    """The last edges of both drives; written in place."""

    rows: Any  # (n,) EDGE
    written: NDArray[np.int64]  # (1,) edges so far


class Capture(NamedTuple):
    """What an ECU's timer has captured of one drive's edges; times in s of the model."""

    edges: int  # so far
    run: int  # in a row in one direction, the way's sign
    last: float  # times of the last four, the newest first
    second: float
    third: float
    fourth: float
    period: float  # of the last full electrical turn, s; 0: none yet


class HallState(NamedTuple):
    """The Hall sensors of one drive."""

    step: int  # where the magnet wheel is, in steps of the square waves
    a: int  # the levels that the decoder saw last
    b: int
    count: int  # type: ignore[assignment]  # shadows tuple.count; what the decoder has counted
    sampled: int  # the count at the start of the present sample period
    speed: int
    shaft: Shaft  # at the last reading
    capture: Capture


class Leg(NamedTuple):
    """A part of a tick in which the shaft turns one way; positions in steps, times in s since the tick's begin."""

    start: float
    end: float
    start_time: float
    end_time: float


class Path(NamedTuple):
    """The shaft's way over a tick: start + speed t + ½ acceleration t²; in steps and s."""

    start: float
    speed: float
    acceleration: float


@compilable
def ideal_count(counts: float, position: float) -> int:
    """A perfect encoder's count at a motor position [rev]; its edges lie half a count beside whole positions."""
    return math.floor(position * counts + 0.5)


@compilable
def hall_levels(step: int) -> tuple[int, int]:
    """Hall A and B (0 or 1) at a step of the shaft: Gray code, A leads B while opening."""
    phase = step % _EDGES_OF_A_TURN
    return (1 if 1 <= phase <= 2 else 0), (1 if phase >= 2 else 0)


@compilable
def decoded(before_a: int, before_b: int, a: int, b: int) -> int:
    """What a quadrature decoder counts for a change of levels: 1 up, −1 down, 0 for none or both at once."""
    phase_before = 2 * before_b + (before_a ^ before_b)
    phase = 2 * b + (a ^ b)
    way = (phase - phase_before) % 4
    if way == 1:
        return 1
    return -1 if way == 3 else 0


@compilable
def displacement(encoder: Encoder, edge: int, way: int, drive: int, seed: int, edges: int) -> float:
    """How far [steps] the edge between step `edge` and the next lies beside its place, for a shaft that turns that
    way (1 opens, −1).
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
    moved += 0.5 * encoder.high if boundary % 2 == 1 else -0.5 * encoder.high  # falls later
    moved += 0.5 * encoder.hysteresis * way
    if encoder.jitter > 0.0:
        moved += encoder.jitter * gaussian(seed, edges, _JITTER + drive)
    return min(max(moved, -_MOST_DISPLACED), _MOST_DISPLACED)


@compilable
def captured(capture: Capture, way: int, time: float) -> Capture:
    """What the timer has after an edge at a time [s]. A period is told once five edges came in one direction."""
    run = capture.run + way if capture.run * way > 0 else way
    return Capture(
        edges=capture.edges + 1,
        run=run,
        last=time,
        second=capture.last,
        third=capture.second,
        fourth=capture.third,
        period=time - capture.fourth if abs(run) > _EDGES_OF_A_TURN else capture.period,
    )


@compilable
def period_speed(encoder: Encoder, capture: Capture, now: float) -> float:
    """The shaft's speed [rev/s] by the last full electrical turn; at a time [s] that is farther from the last edge
    than that turn took, by the time since then.
    """
    if capture.period == 0.0:
        return 0.0
    turn = _EDGES_OF_A_TURN / (encoder.counts * max(capture.period, now - capture.last))
    return math.copysign(turn, float(capture.run))


@compilable
def note_edge(ring: EdgeRing, time: float, drive: int, edge: int, way: int) -> None:
    """Write an edge into the ring."""
    row = ring.rows[ring.written[0] % len(ring.rows)]
    rises = 1 if edge % _EDGES_OF_A_TURN < 2 else 0
    row.time_s = time
    row.drive = drive
    row.channel = edge % 2
    row.level = rises if way > 0 else 1 - rises
    ring.written[0] += 1


@compilable
def path_of(encoder: Encoder, before: Shaft, now: Shaft, length: float) -> Path:
    """The way from one reading to the next, with the positions of both and the change of speed between them."""
    start, end = before.position * encoder.counts + 0.5, now.position * encoder.counts + 0.5
    acceleration = (now.speed - before.speed) * encoder.counts / length
    speed = (end - start) / length - 0.5 * acceleration * length
    return Path(start, speed, acceleration)


@compilable
def crossing(path: Path, leg: Leg, place: float) -> float:
    """When the shaft passes a place within a leg [s since the tick's begin]."""
    way = place - path.start
    root = math.sqrt(max(0.0, path.speed * path.speed + 2.0 * path.acceleration * way))
    final = root if leg.end > leg.start else -root
    # Of the two forms the one that does not cancel.
    if path.speed * final >= 0.0:
        below = path.speed + final
        time = 2.0 * way / below if below != 0.0 else leg.start_time
    else:
        time = (final - path.speed) / path.acceleration
    return min(max(time, leg.start_time), leg.end_time)


@compilable
def along(
    encoder: Encoder,
    hall: HallState,
    path: Path,
    leg: Leg,
    tick: Tick,
    drive: int,
    ring: EdgeRing,
) -> HallState:
    """The Hall sensors at the end of a leg: decoder and timer see every edge, one after the other."""
    step, a, b, count, capture = hall.step, hall.a, hall.b, hall.count, hall.capture
    way = 1 if leg.end > leg.start else -1
    while True:
        edge = step if way > 0 else step - 1
        place = edge + 1.0
        place += displacement(encoder, edge, way, drive, tick.seed, capture.edges)
        if (leg.end < place) if way > 0 else (leg.end >= place):
            break
        step += way
        next_a, next_b = hall_levels(step)
        count += decoded(a, b, next_a, next_b)
        a, b = next_a, next_b
        time = tick.begin + crossing(path, leg, place)
        capture = captured(capture, way, time)
        note_edge(ring, time, drive, edge, way)
    return HallState(step, a, b, count, hall.sampled, hall.speed, hall.shaft, capture)


@compilable
def moved(
    encoder: Encoder, hall: HallState, now: Shaft, tick: Tick, drive: int, ring: EdgeRing
) -> HallState:
    """The Hall sensors after the shaft's way over a tick, which may turn round once."""
    end = now.position * encoder.counts + 0.5
    if (
        encoder.is_ideal
        and hall.step <= end < hall.step + 1.0
        and hall.shaft.speed * now.speed >= 0.0
    ):
        return hall
    path = path_of(encoder, hall.shaft, now, tick.length)
    if abs(end - path.start) > _MOST_EDGES:  # no motor: a state that was set, or has diverged
        step = math.floor(end)
        a, b = hall_levels(step)
        count = hall.count + step - hall.step
        return HallState(step, a, b, count, hall.sampled, hall.speed, hall.shaft, hall.capture)
    turn = tick.length
    if path.speed * (path.speed + path.acceleration * tick.length) < 0.0:
        turn = min(-path.speed / path.acceleration, tick.length)
    at, time = path.start, 0.0
    while time < tick.length:
        is_last = time > 0.0 or turn >= tick.length
        until = tick.length if is_last else turn
        leg = Leg(at, end if is_last else at + 0.5 * path.speed * turn, time, until)
        if leg.end != leg.start:
            hall = along(encoder, hall, path, leg, tick, drive, ring)
        at, time = leg.end, until
    return hall


@compilable
def hall_after(
    encoder: Encoder, hall: HallState, now: Shaft, tick: Tick, drive: int, ring: EdgeRing
) -> HallState:
    """The Hall sensors at the end of a tick; at the end of a sample period the speed is the counts during it."""
    if not abs(now.position * encoder.counts) < _FARTHEST:
        return hall
    after = moved(encoder, hall, now, tick, drive, ring)
    sampled, speed = after.sampled, after.speed
    if tick.is_sample:
        sampled, speed = after.count, after.count - after.sampled
    return HallState(after.step, after.a, after.b, after.count, sampled, speed, now, after.capture)


@compilable
def initial_hall(encoder: Encoder, shaft: Shaft) -> HallState:
    """Hall sensors before the first tick; the decoder has counted from position 0."""
    count = ideal_count(encoder.counts, shaft.position)
    a, b = hall_levels(count)
    return HallState(
        step=count,
        a=a,
        b=b,
        count=count,
        sampled=count,
        speed=0,
        shaft=shaft,
        capture=Capture(edges=0, run=0, last=0.0, second=0.0, third=0.0, fourth=0.0, period=0.0),
    )


def edge_ring(size: int) -> EdgeRing:
    """An empty ring for the last so many edges."""
    return EdgeRing(np.zeros(size, dtype=EDGE).view(np.recarray), np.zeros(1, dtype=np.int64))


def edges_after(ring: EdgeRing, seen: int) -> Any:
    """The edges (n,) EDGE that came after so many, a copy. Raises ValueError where the ring has lost some."""
    written = int(ring.written[0])
    if written - seen > len(ring.rows):
        raise ValueError(f"{written - seen} edges in a ring of {len(ring.rows)}")
    places = np.arange(seen, written) % len(ring.rows)
    return ring.rows[places].copy()

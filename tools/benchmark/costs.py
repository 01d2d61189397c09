"""Benchmark of costs: the times of a plant step, a tick, a simulation and the start of a command.

Every figure is the median of several rounds in one run. Calls in this process are measured in CPU time, so that
other programs may use the machine meanwhile; hot ticks and whole commands are measured in wall time.
"""

from __future__ import annotations

import socket
import statistics
import tempfile
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_compiler import compilable, compiled
from liftgate_hil.codec.frames import Frames, empty_frames
from liftgate_hil.codec.receive import backdate
from liftgate_hil.loop.advance import advance
from liftgate_hil.loop.datagrams import Buffers, longest_wait, make_buffers, read_frames, write_frames
from liftgate_hil.loop.priority import Realtime
from liftgate_hil.loop.python_loop import scheduled_tick
from liftgate_hil.loop.realtime_loop import (
    Room,
    RunParams,
    clock_ns,
    count_bits,
    make_room,
    next_row,
    note_arrivals,
    note_frames,
    receive,
    send,
)
from liftgate_hil.loop.rings import Memory, Shared
from liftgate_hil.loop.tick import LoopConfig, LoopState, constants_in, in_force
from liftgate_hil.plan.plan import loop_config_of, start_of
from liftgate_hil.plan.setup import rig_from, vehicle_from
from liftgate_hil.signals import ROW_WIDTH, Bench
from liftgate_hil.stimuli.stimulus_plan import StimulusPlan, not_made, received, stimulus_plan_of, turns
from liftgate_hil.transport.can_bus import CanTransport
from liftgate_plant import integrate
from liftgate_plant.bridge import DriveInput
from liftgate_plant.dynamics import Inputs, Plant, State
from liftgate_plant.initial import initial_state
from liftgate_plant.vehicle import load_of, plant_of
from tools.benchmark.effort import WHOLE, Effort
from tools.benchmark.processes import whole_process

ROUNDS = 7
HOT = "hot tick with its socket reads and writes, mean over the shipped cycles"


@compilable
def many_steps(plant: Plant, state: State, inputs: Inputs, step: float, count: int) -> State:
    """Return the state after `count` plant steps, made in one call."""
    for _ in range(count):
        state = integrate.step(plant, state, inputs, step)
    return state


@compilable
def hot_ticks(
    config: LoopConfig,
    state: LoopState,
    params: RunParams,
    shared: Shared,
    room: Room,
    peer: Peer,
    every: int,
    count: int,
) -> int:
    """Run `count` ticks in a row, as `run_realtime` does, and return their total time [ns].

    The peer sends a command in one of `every` ticks. Only the ticks are timed, not the work of the peer.
    """
    total = 0
    stimuli, gate, is_new = params.stimuli, config, True
    for number in range(count):
        if number % every == 0:
            write_frames(peer.descriptor, peer.buffers, peer.command, 0)
        begin = clock_ns(1, room)
        frames = receive(shared, params, room)
        now = state.tick * config.step
        if turns(stimuli, now) or is_new:
            gate, is_new = in_force(config, stimuli.faults.row), False
        frames = received(stimuli, config.inputs, frames, state.tick * config.step_ns, config.seed)
        waited = longest_wait(frames, room.stamps, clock_ns(1, room))
        now_ns = state.tick * config.step_ns
        dropped = float(shared.control[0].dropped + shared.control[0].stale)
        bench = Bench(0.0, dropped, 1e-9 * waited, not_made(stimuli))
        place = next_row(shared)
        state, replies, _ = advance(
            gate, state, stimuli, frames, shared.rows[place : place + 1], bench, False, False
        )
        shared.control[0].rows += 1
        if frames.count > 0:
            backdate(config.inputs, state.reception, frames, room.stamps, now_ns, now_ns)
        if replies.count > 0:
            send(shared, params, room, replies, 0)
        note_arrivals(shared, frames, room.stamps, 0)
        note_frames(shared, replies, begin, 1)
        count_bits(shared, frames)
        count_bits(shared, replies)
        total += clock_ns(1, room) - begin
        read_frames(peer.descriptor, peer.buffers, peer.room, peer.stamps)
    return total


class Peer(NamedTuple):
    """Other end of the socket pair: its descriptor and buffers, and the command that it sends."""

    descriptor: int
    buffers: Buffers
    command: Frames
    room: Frames
    stamps: NDArray[np.int64]


def nothing_around(config: LoopConfig) -> StimulusPlan:
    """Return a stimulus plan in which nothing happens."""
    return stimulus_plan_of(constants_in(config))


def hot_tick(sent: int | None, effort: Effort = WHOLE) -> float:
    """Return the seconds of a tick with its socket I/O: the mean of many ticks, and of these the rounds' median.

    If `sent` is None, the traffic is that of the shipped rig at 1 kHz: one command and five sent frames in ten
    ticks. Otherwise each tick reads a command and sends `sent` frames. The ticks run at FIFO priority if it is
    permitted.
    """
    rig = rig_from("liftgate")
    config = loop_config_of(vehicle_from("suv"), rig, 1000.0, 0)
    if sent is not None:
        others = len(config.outputs.messages) - sent
        config.outputs.messages.cycle_ns[:] = [config.step_ns] * sent + [0] * others
    # The command is always the same, so its counter and its checksum are not checked.
    config.inputs.messages.counter[:] = -1
    config.inputs.messages.kind[:] = 0
    state = start_of(config)
    command = empty_frames(1)._replace(count=1)
    command.identifiers[0], command.lengths[0] = rig.command_identifier(), 8
    payload = rig.messages["DriveCommand"].encode(
        {"LeftDuty": 60, "RightDuty": 60, "LeftDirection": 1, "RightDirection": 1,
         "LatchRelease": 1, "AliveCounter": 0, "Checksum": 0}
    )  # fmt: skip
    command.data[0, :8] = np.frombuffer(payload, np.uint8)
    memory = Memory(4096, 65536)
    run = compiled(hot_ticks)
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    count = effort.steps // 10

    def in_thread() -> list[float]:
        Realtime().enter()
        rounds = []
        for _ in range(effort.of(ROUNDS) + 1):
            nanoseconds = run(
                config, state, params, memory.shared, make_room(), peer, 10 if sent is None else 1, count
            )
            rounds.append(nanoseconds * 1e-9 / count)
        return rounds

    with ours, theirs:
        params = RunParams(
            descriptor=ours.fileno(),
            ticks=0,
            limit_ns=10**9,
            command=0x120,
            feedback=np.array([0x210], dtype=np.int64),
            stimuli=nothing_around(config),
            is_last=1,
        )
        peer = Peer(theirs.fileno(), make_buffers(), command, empty_frames(16), np.zeros(16, dtype=np.int64))
        with ThreadPoolExecutor(1) as pool:  # only this thread gets the priority
            rounds = pool.submit(in_thread).result()
    memory.close()
    return statistics.median(rounds[1:])  # the first round compiles


def per_call(action: Callable[[], object], count: int, rounds: int = ROUNDS) -> float:
    """Return the median CPU seconds per unit of an action that does `count` units."""
    times = []
    for _ in range(rounds):
        start = time.thread_time()
        action()
        times.append((time.thread_time() - start) / count)
    return statistics.median(times)


def measure(effort: Effort = WHOLE) -> dict[str, float]:
    """Return all figures by name, in seconds."""
    rounds, many, some = effort.of(ROUNDS), effort.steps, effort.steps // 40
    vehicle = vehicle_from("suv")
    rig = rig_from("liftgate")
    plant = plant_of(vehicle)
    state = initial_state(plant)
    load = load_of(vehicle)._replace(latch_released=1.0)
    drive = DriveInput(0.6, 0.0, 0.0)
    inputs = Inputs(drive, drive, load)
    figures: dict[str, float] = {}

    steps = compiled(many_steps)
    steps(plant, state, inputs, 0.001, 1)
    figures["step, compiled, in a loop"] = per_call(lambda: steps(plant, state, inputs, 0.001, many), many, rounds)
    figures["step, plain Python"] = per_call(lambda: many_steps(plant, state, inputs, 0.001, 200), 200, rounds)

    config = loop_config_of(vehicle, rig, 1000.0, 0)
    loop_state, stimuli = start_of(config), nothing_around(config)
    # As `Loop` calls it: with its stimuli, and with a row of the recording.
    one_tick, row = compiled(scheduled_tick), np.empty((1, ROW_WIDTH))
    frames = empty_frames(1)
    one_tick(config, loop_state, frames, stimuli, row, 0.0, False)

    def called() -> None:
        for _ in range(some):
            one_tick(config, loop_state, frames, stimuli, row, 0.0, False)

    figures["tick, compiled, called from Python"] = per_call(called, some, rounds)

    figures[HOT] = hot_tick(None, effort)
    figures["hot tick with a command read and one frame sent"] = hot_tick(1, effort)
    figures["hot tick with a command read and three frames sent (the heaviest)"] = hot_tick(3, effort)
    with_bus = portable_tick(config, loop_state)
    figures["tick with python-can's virtual bus"] = per_call(lambda: with_bus(some), some, rounds)

    with tempfile.TemporaryDirectory() as folder:
        target = str(Path(folder) / "out.csv")
        arguments = ("simulate", "--voltage", "12", "--output", target)
        figures["simulate, start to exit"] = whole_process(*arguments, "--duration", "0.001", effort=effort).wall
    figures["--help, start to exit"] = whole_process("--help", effort=effort).wall
    figures["emulator, start to exit with one tick"] = whole_process(
        "--bus", "virtual:bench", "--duration", "0.001", "--quiet", effort=effort
    ).wall
    return figures


def portable_tick(config: LoopConfig, state: LoopState) -> Callable[[int], None]:
    """Return a function that runs a number of ticks of the Python loop without waiting, on a virtual bus.

    Each tick receives, evaluates its stimuli, advances and sends.
    """
    transport = CanTransport({"interface": "virtual", "channel": "benchmark"})
    one_tick, stimuli, row = compiled(scheduled_tick), nothing_around(config), np.empty((1, ROW_WIDTH))

    def run(count: int) -> None:
        current = state
        for _ in range(count):
            given = transport.receive()
            current, _, replies, _ = one_tick(config, current, given, stimuli, row, 0.0, False)
            transport.send(replies)

    return run

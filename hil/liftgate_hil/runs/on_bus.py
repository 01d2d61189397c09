"""A run on a bus: in lockstep with an ECU, in real time, or without waiting for anybody."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from liftgate_hil import session
from liftgate_hil.attachment.host import Host
from liftgate_hil.attendance import attendance_of
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.ecu.find import ON_A_BUS
from liftgate_hil.ecu.peer import Peer
from liftgate_hil.emulator import Emulator
from liftgate_hil.errors import ConfigError, LiftgateError, OverrunError, PreconditionError, causes
from liftgate_hil.judging.judge import Judge
from liftgate_hil.loop.recorder import Taker
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.preparation import phases_of
from liftgate_hil.restarting import restarts_of
from liftgate_hil.runs.job import PRIVATE_BUS, Job, Parts, identity_of_ecu
from liftgate_hil.runs.result import Result, nothing_of, result_of
from liftgate_hil.runs.signs_of_life import Progress, foreign_code
from liftgate_hil.runs.start import begin
from liftgate_hil.runs.stepping import CommandLog, StepsAgain, heard_by
from liftgate_hil.staging import off_not_made, opening_of, reset_not_made
from liftgate_hil.stimuli.scene import OFF_A_REAL_BUS
from liftgate_hil.transport.can_arguments import WireChoice
from liftgate_hil.transport.find import find_way, open_transport

if TYPE_CHECKING:
    from liftgate_hil.loop.rings import Memory


def run_on_bus(
    job: Job,
    parts: Parts,
    adapter: Adapter,
    takers: Sequence[Taker],
    stopped: Callable[[], bool],
    memory: Memory | None,
) -> Result:
    """Run a job on its bus, or on one of this process alone, for `takers` of `takers_of`. Raises ConfigError."""
    reason = ""
    host = None if job.attachable_as is None else Host(job.listener, job.attachable_as)
    way = parts.way or find_way(WireChoice(bus=f"virtual:run-{id(parts):x}"), parts.rig)
    with contextlib.ExitStack() as stack:
        peers = []
        try:
            config = session.loop_config_of(
                parts.setup.vehicle, parts.rig, parts.options.rate, parts.setup.seed
            )
            opening = opening_of(parts.rig, host is not None)
            scene, start = begin(parts, config, adapter, stopped, memory, opening)
        except PreconditionError as error:
            nothing = Summary(clock=job.options.clock)
            return result_of(takers, adapter, nothing, "", given_up=str(error))
        except LiftgateError as error:
            return nothing_of(job, "; ".join(causes(error)), 0)
        if job.ecu != ON_A_BUS:
            wire = open_transport(way)
            stack.callback(wire.close)
            guard = functools.partial(foreign_code, memory)
            before_ns = int(scene.origin[0]) * round(session.NS / parts.options.rate)
            peers = [Peer(adapter, wire, (scene.requests, scene.moments), guard, before_ns)]
        listener = host or job.listener
        is_real = not way.is_interface("virtual")  # others are on it: its controller stays on it
        if is_real and any(each.kind == "bus_off" for each in parts.setup.scenario.faults):
            scene.not_made[OFF_A_REAL_BUS] = 1
        waits = parts.options.clock != "realtime"
        restarts = None if peers else restarts_of(parts.rig, scene, listener.say, waits, stopped)
        if restarts is not None:
            stack.callback(restarts.stop)
        attendance = attendance_of(
            scene, parts.setup, parts.rig, is_real, listener, peers, restarts, host
        )
        is_judged = any(isinstance(each, Judge) for each in takers)
        log = CommandLog() if is_judged and parts.options.clock == "realtime" else None
        looking = [*takers, *([log] if log else []), *([Progress(memory)] if memory else [])]
        emulator = Emulator(
            setup=parts.setup,
            rig=parts.rig,
            way=way,
            options=parts.options,
            scene=scene,
            start=start,
            phases=[] if peers else phases_of(parts.setup, parts.rig, 1.0 / parts.options.rate),
            peers=peers,
            ecu=identity_of_ecu(job, parts.setup),
            channel="" if parts.way else PRIVATE_BUS,
            takers=looking,
            listener=listener,
            attendance=attendance,
            events=adapter.events,
            stopped=stopped,
        )
        try:
            emulator.run()
        except ConfigError:
            raise
        except PreconditionError as error:
            return result_of(takers, adapter, emulator.summary, "", given_up=str(error))
        except LiftgateError as error:
            reason = "; ".join(causes(error))
            if isinstance(error, OverrunError) and job.options.clock == "realtime":
                late = f"the bench was late: {reason}"
                return result_of(takers, adapter, emulator.summary, "", given_up=late)
        found = [reset_not_made(scene, parts.rig)]
        if is_real:
            found.append(off_not_made(parts.setup.scenario, attendance.injected))
        if restarts is not None and not reason:
            found.append(restarts.not_made())
    not_made = "; ".join(filter(None, found))
    again = None if log is None else _steps_again(parts, emulator, takers, log, stopped)
    return result_of(takers, adapter, emulator.summary, reason, not_made, again)


def _steps_again(
    parts: Parts,
    emulator: Emulator,
    takers: Sequence[Taker],
    log: CommandLog,
    stopped: Callable[[], bool],
) -> StepsAgain | None:
    """What steps the gate of a run in real time again; None where more than the ECU's commands acted on it."""
    judge = next((each for each in takers if isinstance(each, Judge)), None)
    summary, begun, frames = emulator.summary, emulator.begun, log.frames()
    if judge is None or begun is None or frames is None:
        return None
    if (
        summary.injections or summary.commands
    ):  # they act between two ticks, nobody knows between which
        return None
    return StepsAgain(
        begun=begun,
        frames=heard_by(parts.rig, frames, judge.expected, begun.scene),
        ticks=summary.ticks - 1,
        rig=parts.rig,
        drives=parts.setup.vehicle.drives,
        expected=judge.expected,
        rate=parts.options.rate,
        end=judge.end,
        angles=log.angles(),
        stopped=stopped,
    )

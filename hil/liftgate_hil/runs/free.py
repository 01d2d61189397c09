"""A run in machine code: gate and ECU in this process, waiting for nobody."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from liftgate_hil import session
from liftgate_hil.ecu.adapter import Adapter
from liftgate_hil.errors import ConfigError, LiftgateError, PreconditionError, causes
from liftgate_hil.judging.judge import Judge
from liftgate_hil.loop.closed_loop import Episode
from liftgate_hil.loop.lookout import Lookout
from liftgate_hil.loop.recorder import RecordingTaker, Taker
from liftgate_hil.loop.statistics import Summary
from liftgate_hil.origin import origin_of
from liftgate_hil.recording.content import Content
from liftgate_hil.recording.trigger import Triggered
from liftgate_hil.runs.job import PRIVATE_BUS, Job, Parts, identity_of_ecu
from liftgate_hil.runs.result import Result, nothing_of, result_of
from liftgate_hil.runs.signs_of_life import foreign_code
from liftgate_hil.runs.start import begin
from liftgate_hil.signals import columns_of
from liftgate_hil.staging import trigger_in

if TYPE_CHECKING:
    from liftgate_hil.loop.rings import Memory


def run_free(
    job: Job,
    parts: Parts,
    adapter: Adapter,
    takers: Sequence[Taker],
    stopped: Callable[[], bool],
    memory: Memory | None,
) -> Result:
    """Run a job in machine code, as fast as it goes, for `takers` of `takers_of`. Raises ConfigError."""
    from liftgate_hil.recording.guarded import failures_of
    from liftgate_hil.recording.open import open_recorders

    options, setup = parts.options, parts.setup
    scenario = setup.scenario
    config = session.loop_config_of(setup.vehicle, parts.rig, options.rate, setup.seed)
    ticks = session.ticks_of(
        scenario.duration if options.duration is None else options.duration, options.rate
    )
    if ticks is None:
        raise ConfigError("`duration`: missing; allowed: in the scenario, or given")
    reason = ""
    about = origin_of(setup, parts.rig, options, identity_of_ecu(job, setup))
    content = Content(columns_of(setup.vehicle.drives), PRIVATE_BUS, about=about)
    with contextlib.ExitStack() as stack:
        say = job.listener.say
        recorders = open_recorders(options.records, content, options.limit(), say, stack)
        trigger = trigger_in(setup, parts.rig, options)
        triggered = None if trigger is None else Triggered(trigger)
        recording = RecordingTaker(recorders, sieve=triggered)
        stack.callback(recording.flush)
        if recorders:
            takers = [*takers, recording]
        try:
            scene, start = begin(parts, config, adapter, stopped, memory)
        except PreconditionError as error:
            return result_of(takers, adapter, Summary(clock="free"), "", given_up=str(error))
        except LiftgateError as error:
            return nothing_of(job, "; ".join(causes(error)), 0)
        episode = Episode(
            config,
            start,
            scene,
            adapter,
            takers,
            is_recorded=bool(recorders)
            or any(isinstance(each, Judge) and each.reads_the_bus for each in takers),
            memory=memory,
        )
        # Too fast for a story: the result has it.
        before, reception = int(scene.origin[0]), episode.state.reception
        episode.lookout = Lookout(parts.rig, config, reception, job.listener, ticks_before=before)
        stack.callback(episode.close)
        try:
            job.listener.starts(f"{setup.vehicle_name} on no bus")
            if parts.way is not None:
                job.listener.say("nothing is on the bus: with `clock` free gate and ECU are alone")
            episode.begin()
            with foreign_code(memory):
                episode.run(ticks, stopped)
                episode.finish()
        except LiftgateError as error:
            reason = "; ".join(causes(error))
        summary = episode.summary(parts.rig.bitrate)
    summary.recordings = [file for each in recorders for file in each.files]
    if triggered is not None:
        summary.recording_windows = triggered.count
    reason = "; ".join([*([reason] if reason else []), *failures_of(recorders)])
    return result_of(takers, adapter, summary, reason)

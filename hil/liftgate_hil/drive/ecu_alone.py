"""Run an ECU alone on a bus, with or without a gate at its other end: `liftgate-hil ecu`."""

from __future__ import annotations

import contextlib
import gc
import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from liftgate_compiler import GivenUpError
from liftgate_hil.config.parameters import keys_of
from liftgate_hil.drive.compilation import reporting_compilation
from liftgate_hil.drive.notes import without_effect
from liftgate_hil.ecu.find import adapter_for
from liftgate_hil.ecu.peer import Peer
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.setup import rig_of, scenario_of
from liftgate_hil.plan.stimulation import alone
from liftgate_hil.transport.find import find_way, open_transport
from liftgate_plant.coding import Coding

if TYPE_CHECKING:
    from liftgate_hil.config.rig import Rig
    from liftgate_hil.ecu.adapter import Adapter
    from liftgate_hil.loop.listener import Listener
    from liftgate_hil.plan.request import EcuRequest
    from liftgate_hil.stimuli.requests import Request

_PATIENCE_NS = 2_000_000_000  # without a frame from the gate until a message reports the wait


def drive_alone(request: EcuRequest, listener: Listener, stopped: Callable[[], bool]) -> None:
    """Run an ECU on a bus until it is stopped, or the duration is over.

    Raises ConfigError, TransportError, and EcuError where its code fails.
    """
    coding = _coding(request.coding)
    scenario = scenario_of(request.scenario)
    rig = rig_of(request.rig, scenario)
    with (
        contextlib.suppress(GivenUpError),
        reporting_compilation(listener, stopped),
        adapter_for(request.ecu, rig, request.drives, shares_clock=False, coding=coding) as adapter,
    ):
        way = find_way(request, rig)
        transport, lost_before = open_transport(way), 0
        try:
            requests = _requests(request.request) if request.request else list(scenario.requests)
            if request.no_requests:
                requests = []
            asked = alone(requests)
            listener.say(f"ECU {request.ecu} on {transport.name}; {_planned(requests)}")
            for note in without_effect([each.action for each in requests], adapter):
                listener.say(f"note: {note}")
            peer = Peer(adapter, transport, asked)
            waiting = _Waiting(rig, transport.name, way.within, listener)
            lost_before = peer.dropped  # while machine code was compiled
            with _going_first(request.realtime, listener):
                losses = _Losses(peer, transport.name, listener)
                _take_turns(peer, adapter, waiting, losses, request.duration, stopped, listener)
        finally:
            transport.close()
            counts = transport.counts()
            if faults := counts._replace(dropped=counts.dropped - lost_before).in_words():
                listener.say(f"link: {', '.join(faults.values())}")


def _coding(text: str) -> Coding:
    """Return the vehicle coding given as the text SPEED,LIMITS. Raises ConfigError."""
    known, values = keys_of(Coding), text.split(",")
    if len(values) != len(known):
        raise ConfigError(f"`coding` {text}: allowed: SPEED,LIMITS")
    found = []
    for each, value in zip(known.values(), values, strict=True):
        low, high = each.quantity.low, each.quantity.high
        with contextlib.suppress(ValueError):
            if low <= (number := float(value)) <= high:
                found.append(number)
                continue
        raise ConfigError(f"`coding` {text}: {value!r}; allowed: {low:g} to {high:g}")
    return Coding(*found)


def _planned(requests: Sequence[Request]) -> str:
    """Return a text that lists the ECU's requests and when each of them is made."""
    if not requests:
        return "no requests but those on the bus"
    times = ", ".join(f"{each.action} at {each.when.time:g} s" for each in requests)
    return f"requests, from the gate's first frame on: {times}"


class _Waiting:
    """Reports to the listener that the ECU waits for the gate's first frame."""

    def __init__(self, rig: Rig, bus: str, within: str, listener: Listener) -> None:
        from liftgate_hil.loop.refusal_texts import identifier_text

        names = dict.fromkeys(wire.message for wire in rig.outputs)
        self._gates = ", ".join(f"{name} ({identifier_text(rig.identifier(name))})" for name in names)
        self._bus, self._listener, self._text_of = bus, listener, identifier_text
        self._nothing = f"nothing received{f'; {within}' if within else ''}"
        self._is_told, self._has_told_other = False, False

    def look(self, now: int, peer: Peer) -> None:
        """Report, `now` [ns] after the start, a long wait for the gate, foreign frames meanwhile, and its end."""
        other = peer.first_other
        if peer.has_heard_the_gate:
            if self._is_told:
                self._listener.say("frames of the gate received")
            self._is_told = False
        elif now > _PATIENCE_NS and not (self._is_told and (self._has_told_other or other < 0)):
            heard = self._nothing
            if other >= 0:
                remedy = "check that `rig` is that of the gate"
                heard = f"{self._text_of(other)} received, which is not the gate's: {remedy}"
            if peer.has_received:
                heard = "they come, but are refused: another rig, a wrong checksum or length"
            self._listener.say(f"waits for frames of the gate on {self._bus}: {heard}; the rig's: {self._gates}")
            self._is_told, self._has_told_other = True, other >= 0


class _Losses:
    """Reports to the listener, once, that frames were dropped since its creation before this process read them."""

    def __init__(self, peer: Peer, bus: str, listener: Listener) -> None:
        self._peer, self._bus, self._listener = peer, bus, listener
        self._before = peer.dropped
        self._is_told = False

    def look(self, now: int) -> None:
        """Report, once, that frames were dropped, `now` [ns] after the start."""
        if not self._is_told and self._peer.dropped > self._before:
            self._is_told = True
            self._listener.say(
                f"{now * 1e-9:.3f} s: frames on {self._bus} are dropped before this process reads them: "
                "what the ECU does from now on may be the bench's fault"
            )


def _take_turns(
    peer: Peer,
    adapter: Adapter,
    waiting: _Waiting,
    losses: _Losses,
    duration: float | None,
    stopped: Callable[[], bool],
    listener: Listener,
) -> None:
    """Poll the ECU each ms, and report events, waiting and losses, for `duration` [s]; None: until stopped."""
    gc.collect()  # collects garbage of the start now, not for some 50 ms during a motion
    gc.freeze()
    start = time.monotonic_ns()
    shown, has_heard = 0, False
    try:
        while not stopped():
            now = time.monotonic_ns() - start
            peer.poll(now)
            losses.look(now)
            if duration is not None and now * 1e-9 >= duration:
                break
            for event in adapter.events(shown):
                listener.happened(event.time, event.text)
                shown += 1
            if not has_heard:
                waiting.look(now, peer)
                has_heard = peer.has_heard_the_gate
            time.sleep(0.001)
    finally:
        peer.finish()


@contextlib.contextmanager
def _going_first(realtime: bool | None, listener: Listener) -> Iterator[None]:
    """Context in which this thread has FIFO priority, unless `realtime` is False; a refusal is reported."""
    from liftgate_hil.loop.priority import FIFO, PRIORITY, going_first, in_one_line

    if realtime is False:
        yield
        return
    with going_first(PRIORITY) as refused:  # that of the gate's loop, so that this process never starves it
        if refused:
            listener.say(f"refused: {refused}" if realtime else in_one_line([FIFO]))
        yield


def _requests(given: Sequence[str]) -> list[Request]:
    """Return the requests given as texts SECONDS:ACTION. Raises ConfigError."""
    from liftgate_hil.stimuli.moments import Instant
    from liftgate_hil.stimuli.requests import REQUESTS, Request

    requests = []
    for text in given:
        when, _, action = text.partition(":")
        try:
            time_s = float(when)
        except ValueError:
            time_s = math.nan
        requests.append(Request(Instant(time_s), action))
        if not 0.0 <= time_s <= 1e6:
            action = ""
        if action not in REQUESTS:
            raise ConfigError(f"`request` {text}: allowed: SECONDS:ACTION with {', '.join(REQUESTS)}")
    return requests

"""An ECU alone, on any bus: drives the gate as a car's control unit would, by the messages on the bus.

The reference ECU obeys the scenario's [[request]] tables (default: the demo's), or the requests of --request.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import math
import signal
import time
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from liftgate_hil.cli import options
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.config.vehicle_choice import WireChoice
from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.errors import ConfigError
from liftgate_hil.isolate.supervisor import supervise
from liftgate_hil.plan.request import RunRequest
from liftgate_plant.coding import UNCODED, Coding

if TYPE_CHECKING:
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.config.rig import Rig
    from liftgate_hil.config.scenario import Scenario
    from liftgate_hil.ecu.adapter import Adapter
    from liftgate_hil.ecu.peer import Peer
    from liftgate_hil.stimuli.requests import Request


_EXIT_CODES = frozenset((0, 1, 2, 128 + signal.SIGINT, 128 + signal.SIGTERM))  # exit codes of this command
_PATIENCE_NS = 2_000_000_000  # without a frame from the gate until a message reports the wait


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags to the parser."""
    options.add_flags(parser, WireChoice)
    options.add_flags(parser, RunRequest, "rig", "ecu", "scenario", scenario="demo")
    parser.add_argument(
        "--request",
        action="append",
        default=[],
        metavar="TIME:ACTION",
        help="request instead of the scenario's: seconds after the gate's first frame, and open, close, "
        "stop or reset (repeatable)",
    )
    parser.add_argument(
        "--no-requests",
        action="store_true",
        help="ignore the scenario's requests, obey only those on the bus (the rig's [requests])",
    )
    parser.add_argument("--drives", type=int, choices=(1, 2), default=2, help="drives of the gate; default: 2")
    parser.add_argument(
        "--coding",
        type=_coding,
        default=UNCODED,
        metavar="SPEED,LIMITS",
        help="closing_speed and anti_trap_limits of the vehicle file's [coding] (default: 1,1)",
    )
    parser.add_argument(
        "--duration",
        type=options.bounded(1e-3, 1e9, "s"),
        metavar="S",
        help="seconds after the start; default: until stopped",
    )
    parser.add_argument(
        "--realtime",
        action=argparse.BooleanOptionalAction,
        help="request FIFO scheduling, and report a refusal in full; --no-realtime: do not; default: where it is "
        "granted",
    )
    parser.add_argument("--quiet", action="store_true", help="no messages but errors")


def _coding(text: str) -> Coding:
    """Convert SPEED,LIMITS to a Coding, as an argparse type."""
    from liftgate_hil.config.parameters import keys_of

    known = keys_of(Coding)
    values = text.split(",")
    if len(values) != len(known):
        raise argparse.ArgumentTypeError(f"{text!r}; allowed: SPEED,LIMITS")
    bounds = [options.bounded(each.quantity.low, each.quantity.high, "") for each in known.values()]
    return Coding(*(bound(value) for bound, value in zip(bounds, values, strict=True)))


def run(args: argparse.Namespace) -> int:
    """Run the command and return the exit code."""
    from liftgate_hil.ecu.find import is_foreign

    if is_foreign(args.ecu) and args.owns_process:
        supervise(allowed=_EXIT_CODES)
    stop = StopSignals()
    from liftgate_compiler import GivenUpError
    from liftgate_hil.cli.teller import Teller
    from liftgate_hil.drive.compilation import reporting_compilation
    from liftgate_hil.ecu.find import adapter_for, is_library
    from liftgate_hil.errors import EcuError
    from liftgate_hil.plan.setup import rig_of, scenario_from

    if args.ecu == ON_A_BUS:
        raise ConfigError("`ecu` bus: allowed here: reference, LIBRARY, MODULE:CLASS")
    if is_library(args.ecu):
        stop.end_machine_code()
    scenario = scenario_from(args.scenario)
    rig = rig_of(args.rig, scenario)
    teller = Teller(args.quiet)
    try:
        with (
            contextlib.suppress(GivenUpError),
            reporting_compilation(teller, stop),
            adapter_for(options.ecu_of(args), rig, args.drives, shares_clock=False, coding=args.coding) as adapter,
        ):
            _drive(args, rig, scenario, adapter, stop, teller)
    except EcuError as error:
        raise stop.failure(str(error)) from error
    return 0


def _drive(
    args: argparse.Namespace, rig: Rig, scenario: Scenario, adapter: Adapter, stop: StopSignals, teller: Teller
) -> None:
    """Run the ECU until it is stopped, or the duration is over."""
    from liftgate_hil.drive.notes import without_effect
    from liftgate_hil.ecu.peer import Peer
    from liftgate_hil.plan.stimulation import alone
    from liftgate_hil.transport.find import find_way, open_transport

    way = find_way(options.wire_choice(args), rig)
    transport, lost_before = open_transport(way), 0
    try:
        requests = _requests(args.request) if args.request else list(scenario.requests)
        if args.no_requests:
            requests = []
        asked = alone(requests)
        teller.say(f"ECU {args.ecu} on {transport.name}; {_planned(requests)}")
        for note in without_effect([each.action for each in requests], adapter):
            teller.say(f"note: {note}")
        peer = Peer(adapter, transport, asked)
        waiting = _Waiting(rig, transport.name, way.within, teller)
        lost_before = peer.dropped  # while machine code was compiled
        with _going_first(args.realtime, teller):
            _take_turns(peer, adapter, waiting, _Losses(peer, transport.name, teller), args.duration, stop, teller)
    finally:
        transport.close()
        counts = transport.counts()
        if faults := counts._replace(dropped=counts.dropped - lost_before).in_words():
            teller.say(f"link: {', '.join(faults.values())}")


def _planned(requests: Sequence[Request]) -> str:
    """Return a text on when the ECU is asked for what."""
    if not requests:
        return "no requests but those on the bus"
    times = ", ".join(f"{each.action} at {each.when.time:g} s" for each in requests)
    return f"requests, from the gate's first frame on: {times}"


class _Waiting:
    """Messages on the wait for the gate's first frame."""

    def __init__(self, rig: Rig, bus: str, within: str, teller: Teller) -> None:
        from liftgate_hil.loop.refusal_texts import identifier_text

        names = dict.fromkeys(wire.message for wire in rig.outputs)
        self._gates = ", ".join(f"{name} ({identifier_text(rig.identifier(name))})" for name in names)
        self._bus, self._teller, self._text_of = bus, teller, identifier_text
        self._nothing = f"nothing received{f'; {within}' if within else ''}"
        self._is_told, self._has_told_other = False, False

    def look(self, now: int, peer: Peer) -> None:
        """Report the wait once it is long, what else is on the bus, and that it is over."""
        other = peer.first_other
        if peer.has_heard_the_gate:
            if self._is_told:
                self._teller.say("frames of the gate received")
            self._is_told = False
        elif now > _PATIENCE_NS and not (self._is_told and (self._has_told_other or other < 0)):
            heard = self._nothing
            if other >= 0:
                remedy = "check that `rig` is that of the gate"
                heard = f"{self._text_of(other)} received, which is not the gate's: {remedy}"
            if peer.has_received:
                heard = "they come, but are refused: another rig, a wrong checksum or length"
            self._teller.say(f"waits for frames of the gate on {self._bus}: {heard}; the rig's: {self._gates}")
            self._is_told, self._has_told_other = True, other >= 0


class _Losses:
    """Message on the first frames that are dropped from now on before this process reads them."""

    def __init__(self, peer: Peer, bus: str, teller: Teller) -> None:
        self._peer, self._bus, self._teller = peer, bus, teller
        self._before = peer.dropped
        self._is_told = False

    def look(self, now: int) -> None:
        """Report the loss, once."""
        if not self._is_told and self._peer.dropped > self._before:
            self._is_told = True
            self._teller.say(
                f"{now * 1e-9:.3f} s: frames on {self._bus} are dropped before this process reads them: "
                "what the ECU does from now on may be the bench's fault"
            )


def _take_turns(
    peer: Peer,
    adapter: Adapter,
    waiting: _Waiting,
    losses: _Losses,
    duration: float | None,
    stop: StopSignals,
    teller: Teller,
) -> None:
    """Poll the ECU for `duration` [s] from the start; None: until it is stopped."""
    gc.collect()  # collects garbage of the start now, not for some 50 ms during a motion
    gc.freeze()
    start = time.monotonic_ns()
    shown, has_heard = 0, False
    try:
        while not stop():
            now = time.monotonic_ns() - start
            peer.poll(now)
            losses.look(now)
            if duration is not None and now * 1e-9 >= duration:
                break
            for event in adapter.events(shown):
                teller.happened(event.time, event.text)
                shown += 1
            if not has_heard:
                waiting.look(now, peer)
                has_heard = peer.has_heard_the_gate
            time.sleep(0.001)
    finally:
        peer.finish()


@contextlib.contextmanager
def _going_first(realtime: bool | None, teller: Teller) -> Iterator[None]:
    """Let this thread go before others, as far as the user wants and the machine permits."""
    from liftgate_hil.loop.priority import FIFO, PRIORITY, going_first, in_one_line

    if realtime is False:
        yield
        return
    with going_first(PRIORITY) as refused:  # that of the gate's loop, so that this process never starves it
        if refused:
            teller.say(f"refused: {refused}" if realtime else in_one_line([FIFO]))
        yield


def _requests(given: list[str]) -> list[Request]:
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

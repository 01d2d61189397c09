"""Replay of a recording's frames onto a bus or a serial line."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

from liftgate_hil.config.described import command
from liftgate_hil.config.sources import sources_of
from liftgate_hil.formats.recording import read_options
from liftgate_hil.loop.listener import Listener, Relay
from liftgate_hil.plan.provenance import provenance_of
from liftgate_hil.plan.setup import rig_of
from liftgate_hil.playback.player import Played, Player, Replay
from liftgate_hil.playback.request import ReplayRequest
from liftgate_hil.playback.selection import Selection, identifiers_of
from liftgate_hil.transport.find import find_way


@command(ReplayRequest)
def replay(request: ReplayRequest) -> Played:
    """Play the frames of a recording onto a bus or a serial line, with the original timing.

    Without `direction` it plays the frames that are marked as sent; if there are none, as in logs without
    directions, all of them. The result tells how late the frames were: from when each was due until the kernel,
    or the driver of another interface, had it.

        replay("run.blf", bus="socketcan:vcan0", to_s=10.0).frames_sent

    A `loop` ends with an interrupt (Ctrl-C). Raises ConfigError, TransportError.
    """
    noted = NotingRelay(Listener())
    player = player_for(request, noted)
    try:
        player.run()
    except KeyboardInterrupt:
        if not request.loop:
            raise
        player.played.stop_reason = "SIGINT"
    return summed_up(request, player.played, repr(request), noted.notes)


class NotingRelay(Relay):
    """Listener that records a replay's texts and alarms, and passes them on to another listener."""

    def __init__(self, listener: Listener) -> None:
        super().__init__(listener)
        self.notes: list[str] = []

    def say(self, text: str) -> None:
        """Record a text, and pass it on to the other listener."""
        self.notes.append(text)
        super().say(text)

    def alarm(self, text: str) -> None:
        """Record an alarm, and pass it on to the other listener."""
        self.notes.append(text)
        super().alarm(text)


def player_for(
    request: ReplayRequest,
    listener: Listener | None = None,
    stopped: Callable[[], bool] = lambda: False,
    progress: Callable[[float, float, int], None] = lambda seconds, end, sent: None,
) -> Player:
    """Return the player for a request, with its recording opened. Raises ConfigError."""
    rig = rig_of(request.rig)
    selection = Selection(
        direction=request.direction or "",
        only=identifiers_of("only", request.only, rig.messages),
        without=identifiers_of("without", request.without, rig.messages),
        begin=-math.inf if request.from_s is None else request.from_s,
        end=math.inf if request.to_s is None else request.to_s,
    )
    chosen = Replay(
        Path(request.recording),
        selection,
        how=read_options(request.recording_channel, request.timezone),
        speed=request.speed,
        times=None if request.loop else request.times,
        realtime=request.realtime,
        cpu=request.cpu,
    )
    return Player(chosen, find_way(request, rig), listener or Listener(), stopped, progress)


def summed_up(request: ReplayRequest, played: Played, command_line: str, notes: Sequence[str] = ()) -> Played:
    """Add notes and provenance to a replay's summary, and return it; the recording is hashed for this."""
    played.notes = tuple(notes)
    played.provenance = provenance_of(command_line, sources_of({"recording": Path(request.recording)}))
    return played

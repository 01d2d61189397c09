"""Requests of a dashboard page: as part of a run, or as a command of its own."""

from pathlib import Path
from typing import Annotated

from liftgate_hil.config.choices import RecordingChannel, TimeZone
from liftgate_hil.config.described import Field, Record
from liftgate_hil.config.kinds import File, Flag, Number, Text, Whole
from liftgate_hil.errors import ConfigError

LISTEN = "127.0.0.1:8765"
_ADDRESS = "address of the page; port 0: any free port"
_READ_ONLY = "the page cannot send commands"
# Arguments, and those of which one goes with them.
_GOES_WITH = {
    "rig": ("recording", "scenarios"), "vehicle": ("recording", "scenarios"), "bus": ("scenarios",),
    "ecu": ("scenarios",), "recording_channel": ("recording",), "timezone": ("recording",),
}  # fmt: skip


# fmt: off
class RunPage(Record):
    """Base class of requests of runs with a page: the flags of the page."""

    dashboard: Annotated[bool, Field(Flag(), "serve the operator's page of this run, see liftgate-hil "
        "dashboard")] = False
    listen: Annotated[str | None, Field(Text("HOST:PORT"), _ADDRESS, LISTEN, "HOST:PORT", "dashboard")] = None
    read_only: Annotated[bool, Field(Flag(), _READ_ONLY, needs="dashboard")] = False


class DashboardRequest(Record):
    """Request of a dashboard page for a run, for a recording, or to start scenarios from it."""

    attach: Annotated[int | None, Field(Whole(1, 2**31), "process id of a run", metavar="PID")] = None
    recording: Annotated[str | Path | None, Field(File(), "a recording, or a bus log with --rig",
        metavar="FILE")] = None
    scenarios: Annotated[str | Path | None, Field(File(), "start scenarios of this folder (pack: shipped) from "
        "the page", metavar="FOLDER")] = None
    rig: Annotated[str | Path | None, Field(File(), "with --recording: the rig that decodes its frames; with "
        "--scenarios: its rig", metavar="NAME|FILE")] = None
    vehicle: Annotated[str | Path | None, Field(File(), "with --recording: the vehicle to draw, in place of "
        "the one in the file; with --scenarios: its vehicle", metavar="NAME|FILE")] = None
    recording_channel: RecordingChannel = None
    timezone: TimeZone = None
    bus: Annotated[str | None, Field(Text("INTERFACE:CHANNEL"), "with --scenarios: the bus of the runs",
        "one inside the run", "INTERFACE:CHANNEL")] = None
    ecu: Annotated[str | None, Field(Text("ECU"), "with --scenarios: what closes the loop, as of a run",
        "reference", "ECU")] = None
    listen: Annotated[str, Field(Text("HOST:PORT"), _ADDRESS, metavar="HOST:PORT")] = LISTEN
    read_only: Annotated[bool, Field(Flag(), _READ_ONLY)] = False
    # Set by a run with a page: how long it may take to begin [s], and the socket to listen on.
    patience: Annotated[float, Field(Number(0.0, 1e6, "s"), "")] = 0.0
    descriptor: Annotated[int | None, Field(Whole(0, 2**20), "")] = None

    # fmt: on
    def check(self) -> None:
        """Validate the arguments, each and together. Raises ConfigError."""
        super().check()
        sources = [name for name in ("attach", "recording", "scenarios") if getattr(self, name) is not None]
        if len(sources) > 1:
            raise ConfigError(f"{', '.join(f'`{each}`' for each in sources)}: allowed: one of them")
        for name, goes_with in _GOES_WITH.items():
            given = getattr(self, name)
            if given is not None and all(getattr(self, each) is None for each in goes_with):
                allowed = " or ".join(f"`{each}`" for each in goes_with)
                raise ConfigError(f"`{name}` {given}: allowed with {allowed}")


def address_of(text: str) -> tuple[str, int]:
    """Return host and port of a text HOST:PORT. Raises ConfigError."""
    host, _, port = text.rpartition(":")
    host = host.removeprefix("[").removesuffix("]")
    if not host or not (port.isascii() and port.isdecimal()) or int(port) > 65535:
        raise ConfigError(f"`listen` {text}: allowed: HOST:PORT, such as {LISTEN}; port 0 to 65535")
    return host, int(port)

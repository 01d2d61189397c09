"""Request of `replay`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from liftgate_hil.config.choices import RecordingChannel, TimeZone, WireChoice
from liftgate_hil.config.described import Field, Record
from liftgate_hil.config.kinds import Choice, File, Flag, Names, Number, Whole
from liftgate_hil.config.shipped import DEFAULT_RIG
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_hil.formats.suffixes import WITH_FRAMES
from liftgate_hil.plan.request import AskForRealtime

DIRECTIONS = ("sent", "received", "both")
_TIME = Number(-1e9, 1e9, "s")
_IDENTIFIERS = "0x120, 0x200-0x2FF, or a message of the rig (repeatable)"


class Identifiers:
    """Kind of value: identifiers of frames, as numbers, or as texts in a list or separated by commas."""

    allowed: str = "0x120, 0x200-0x2FF, or a message of the rig"
    invalid: tuple[str, ...] = ()

    def read(self, issues: ConfigIssues, key: str, value: Any) -> tuple[str, ...]:
        """Return the identifiers as texts; an empty tuple and an issue if they are invalid."""
        given = value if isinstance(value, list) else [value]
        texts = [f"0x{each:X}" if type(each) is int else each for each in given]
        return Names(self.allowed).read(issues, key, texts)


# fmt: off
class ReplayedFile(Record, kw_only=False):
    """Base class of the replay request: the file to replay, which is its only positional argument."""

    recording: Annotated[str | Path, Field(File(), "a recording with frames, or a bus log: "
        + " ".join(WITH_FRAMES), metavar="FILE")]


class ReplayRequest(ReplayedFile, WireChoice):
    """Request to play a recording's frames onto a bus or a serial line."""

    rig: Annotated[str | Path | None, Field(File(), "the rig: mapping of bus signals",
        DEFAULT_RIG, "NAME|FILE")] = None
    recording_channel: RecordingChannel = None
    timezone: TimeZone = None
    direction: Annotated[str | None, Field(Choice(DIRECTIONS), "which frames to play: sent or received by the "
        "gate",
        "sent, both if none is marked as sent")] = None
    only: Annotated[Sequence[str], Field(Identifiers(), f"only these frames: "
        f"{_IDENTIFIERS}", metavar="ID,…")] = ()
    without: Annotated[Sequence[str], Field(Identifiers(), f"all but these frames: "
        f"{_IDENTIFIERS}", metavar="ID,…",
        flag="except")] = ()
    from_s: Annotated[float | None, Field(_TIME, "begin at this time of the recording", "with its first "
        "frame", "S",
        flag="from", also=("--start",))] = None
    to_s: Annotated[float | None, Field(_TIME, "end at this time of the recording", "with its last frame", "S",
        flag="to", also=("--end",))] = None
    speed: Annotated[float, Field(Number(0.001, 1000.0), "2: twice as fast", metavar="FACTOR")] = 1.0
    times: Annotated[int, Field(Whole(1, 10**9), "play it N times, each right after the last frame, or --to",
        metavar="N")] = 1
    loop: Annotated[bool, Field(Flag(), "repeat until stopped")] = False
    realtime: AskForRealtime = None
    cpu: Annotated[int | None, Field(Whole(0, 1023), "the CPU of the loop in real time",
        "an isolated one, else the last", "N")] = None

    # fmt: on
    def check(self) -> None:
        """Validate the values, each and together. Raises ConfigError."""
        super().check()
        if self.from_s is not None and self.to_s is not None and not self.from_s < self.to_s:
            raise ConfigError(f"`from_s` {self.from_s:g}: not before `to_s` {self.to_s:g}; allowed: before `to_s`")
        if self.loop and self.times != 1:
            raise ConfigError(f"`times` {self.times}: not allowed with `loop`")
        if self.cpu is not None and self.realtime is False:
            raise ConfigError(f"`cpu` {self.cpu}: allowed: together with `realtime`")

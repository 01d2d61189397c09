"""Request to examine whether this machine is fit for real-time runs."""

from typing import Annotated

from liftgate_hil.config.described import Field, Record
from liftgate_hil.config.kinds import Number, Whole
from liftgate_hil.plan.request import DEFAULT_RATE, AskForRealtime, Rate


# fmt: off
class DoctorRequest(Record):
    """Request to examine this machine: tick rate, duration of the measurements, and real-time settings."""

    duration: Annotated[float, Field(Number(0.1, 86_400.0, "s"), "duration of each lateness measurement; an hour "
        "shows rare delays", metavar="S")] = 2.0
    rate: Rate = DEFAULT_RATE
    realtime: AskForRealtime = None
    cpu: Annotated[int | None, Field(Whole(0, 1023), "the CPU of the loop in real time",
        "an isolated one, else the last", "N")] = None

"""Choice of the wire between gate and ECU, as commands take it."""

from __future__ import annotations

import os
from typing import Annotated

from liftgate_hil.config.described import Field, Record
from liftgate_hil.config.kinds import Flag, Text, Whole


# fmt: off
class WireChoice(Record):
    """The wire that the user chose: a bus by one text or by python-can's own options, or a serial port."""

    bus: Annotated[str | None, Field(Text("INTERFACE:CHANNEL[@BITRATE]"), "the CAN bus, e.g. socketcan:vcan0",
        metavar="INTERFACE:CHANNEL[@BITRATE]")] = None
    serial: Annotated[str | None, Field(Text("PORT[@BAUD]"), "instead of a bus: a device or URL of pyserial, e.g. "
        "/dev/ttyUSB0@921600", metavar="PORT[@BAUD]")] = None
    interface: Annotated[str | None, Field(Text(), "python-can's interface, instead of "
        "--bus", also=("-i",))] = None
    channel: Annotated[str | None, Field(Text(), "python-can's channel, instead of --bus", also=("-c",))] = None
    bitrate: Annotated[int | None, Field(Whole(1, 100_000_000), "bit/s", "the rig's", also=("-b",))] = None
    is_fd: Annotated[bool, Field(Flag(), "open the bus for CAN FD", flag="fd")] = False

    # fmt: on
    @property
    def is_given(self) -> bool:
        """Whether the user chose a wire at all."""
        named = (self.bus, self.serial, self.interface, self.channel)
        return any(each is not None for each in named)

    @property
    def is_configured(self) -> bool:
        """Whether python-can's configuration names a bus: can.conf, or CAN_* in the environment."""
        from liftgate_hil.config.can_libraries import can

        try:
            return can.util.load_config().get("interface") is not None
        except Exception:  # what is wrong with it is told where it is used
            return any(name.startswith("CAN_") for name in os.environ)

"""What requests say of the columns of measurements."""

from __future__ import annotations

from typing import Annotated

from liftgate_hil.config.described import Field, Record
from liftgate_hil.config.kinds import Texts

# fmt: off
Maps = Annotated[tuple[str, ...], Field(Texts("a list of OURS=THEIRS[unit], or a file"), "read a column that has "
    "another name or unit, e.g. 'left_voltage_v=U[mV]*0.5', or a FILE.toml with a table [columns] (repeatable)",
    metavar="OURS=THEIRS[unit]", flag="map")]


class MapRequest(Record):
    """Base of the requests that map columns."""

    maps: Maps = ()

"""Base class of the requests that read measurements whose columns may have other names."""

from collections.abc import Sequence
from typing import Annotated

from liftgate_hil.config.described import Field, Record
from liftgate_hil.config.kinds import Texts


# fmt: off
class MapRequest(Record):
    """Base class of the requests with `maps`, which assigns a file's columns to known ones."""

    maps: Annotated[Sequence[str], Field(Texts("a list of OURS=THEIRS[unit], or a file"), "read a "
        "column that has another name or unit, e.g. 'left_voltage_v=U[mV]*0.5', or a FILE.toml with a table "
        "[columns] (repeatable)",
        metavar="OURS=THEIRS[unit]", flag="map")] = ()

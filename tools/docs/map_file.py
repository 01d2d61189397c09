"""Page docs/map-file.md: all keys of a map file, and the columns that files may hold, from their readers."""

from __future__ import annotations

from liftgate_hil.measurement.mapping import KNOWN, ColumnTable, MapTable, allowed_units
from tools.docs.markdown import code, page, table
from tools.docs.schema import key_table

_INTRO = """\
A map file is written in TOML and given to `--map` of `identify`, `validate`, `simulate` and `judge`. It says which
column of a file is which of this program, in what unit:

    [columns]
    time_s = "t"
    left_current_a = { name = "Iq", unit = "mA", scale = -1.0, offset = 0.0 }

The value is scale · value + offset, in the given unit. See [measurements](measurements.md)."""
_COLUMNS = """\
The columns of measurements and of the input of `simulate`. `judge` knows all [signals](signals.md). A unit that is
allowed may also follow the name of the file's column in brackets: `Iq [mA]`.
Other usual spellings of a unit (`1/min`, `°`, `us`, `degC`) are read as well."""


def map_file_page() -> str:
    """Return the text of the page."""
    meanings = {name: each.meaning for name, each in KNOWN.items()}
    meanings["voltage_v"] += ", of both drives"
    columns = ((code(name), allowed_units(name), meaning) for name, meaning in meanings.items())
    return page(
        "Map files",
        _INTRO,
        "## The file",
        key_table(MapTable),
        "## A column",
        key_table(ColumnTable),
        "## Columns",
        _COLUMNS,
        table(["column", "allowed units", "meaning"], columns),
    )

"""A database and a rig made from the catalogue: each quantity in its own message, as a double."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from pathlib import Path

from hil_support import decoded, rig_of

from liftgate_hil.codec.frames import Frames
from liftgate_hil.config.rig import Rig
from liftgate_hil.config.units import dimension_of
from liftgate_hil.signals import BUS_INPUTS, BUS_OUTPUTS

FIRST_INPUT, FIRST_OUTPUT = 0x100, 0x300
HEAD = 'VERSION ""\nBS_:\nBU_: A\n'
CYCLES = 'BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;\nBA_DEF_DEF_ "GenMsgCycleTime" 10;\n'


SECTIONS = (("inputs", "In", BUS_INPUTS), ("outputs", "Out", BUS_OUTPUTS))


def _identifiers() -> dict[str, int]:
    """Return the identifiers by message name."""
    return {
        **{f"In_{name}": FIRST_INPUT + place for place, name in enumerate(BUS_INPUTS)},
        **{f"Out_{name}": FIRST_OUTPUT + place for place, name in enumerate(BUS_OUTPUTS)},
    }


def _wires() -> Iterator[str]:
    """Yield the lines of a rig file that maps each quantity to its signal."""
    yield 'dbc = "their.dbc"'
    for section, prefix, quantities in SECTIONS:
        yield f"[{section}]"
        for name, quantity in quantities.items():
            scale = ", scale = 1" if quantity.values else ""
            yield f'{name} = {{ signal = "{prefix}_{name}.Value"{scale} }}'


def catalogue_rig(folder: Path) -> Rig:
    """Return a rig that maps every quantity that can be mapped."""
    messages = _identifiers()
    database = HEAD
    for _, prefix, quantities in SECTIONS:
        for name, quantity in quantities.items():
            message = f"{prefix}_{name}"
            unit = quantity.unit or ("" if dimension_of(quantity) == "number" else "1")
            database += f"BO_ {messages[message]} {message}: 8 A\n"
            database += f' SG_ Value : 0|64@1- (1,0) [0|0] "{unit}" A\n'
    database += CYCLES
    database += "".join(f"SIG_VALTYPE_ {identifier} Value : 2;\n" for identifier in messages.values())
    return rig_of(folder, database, "\n".join(_wires()))


def input_frames(values: Mapping[str, float]) -> list[tuple[int, bytes]]:
    """Return frames with these values of BUS_INPUTS, in any order but the catalogue's."""
    identifiers = _identifiers()
    return [(identifiers[f"In_{name}"], struct.pack("<d", value)) for name, value in reversed(values.items())]


def outputs_in(rig: Rig, frames: Frames) -> dict[str, float]:
    """Decode frames with cantools; return each quantity of BUS_OUTPUTS in them, which must occur once."""
    found = {}
    for name in BUS_OUTPUTS:
        rows = decoded(rig, frames, f"Out_{name}")
        assert len(rows) <= 1, name
        if rows:
            found[name] = float(rows[0]["Value"])
    assert len(found) == frames.count
    return found

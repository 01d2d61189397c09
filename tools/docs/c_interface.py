"""Page docs/c-interface.md: the C interfaces of an ECU, as their headers state them."""

from __future__ import annotations

from pathlib import Path

import liftgate_hil
from tools.docs.markdown import page

_HIL = Path(liftgate_hil.__file__).parent
_INTRO = """\
An ECU in C is a shared library with the functions of `liftgate_ecu.h`, or a program on a bus or a serial line;
`liftgate_serial.h` describes the frames on the line. [An ECU in C](own-ecu.md) shows how it is built and run."""
_HEADERS = {"A library": "ecu/liftgate_ecu.h", "A serial line": "transport/liftgate_serial.h"}


def c_interface_page() -> str:
    """Return the text of the page."""
    parts = []
    for title, name in _HEADERS.items():
        path = _HIL / name
        parts += [f"## {title}: `{path.name}`", f"```c\n{path.read_text(encoding='utf-8').strip()}\n```"]
    return page("C interface", _INTRO, *parts)

"""Find and load the database that a rig names: DBC, ARXML, KCD or SYM, read by cantools."""

from __future__ import annotations

import codecs
import functools
import math
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liftgate_hil.config.files import is_there, read_bytes
from liftgate_hil.config.shipped import data_root
from liftgate_hil.config.toml import show, text
from liftgate_hil.errors import ConfigError, ConfigIssues

if TYPE_CHECKING:
    from cantools.database.can import Message

# File suffix: encoding of files that are not UTF-8.
KINDS = {".dbc": "cp1252", ".arxml": "utf-8", ".kcd": "utf-8", ".sym": "cp1252"}
# Suffixes that are named by mistake, and what such a file is.
_OTHERS = {
    ".cdd": "a diagnostic database",
    ".odx": "a diagnostic database",
    ".pdx": "a diagnostic database",
    ".ldf": "a LIN database",
    ".a2l": "a calibration database",
    ".dbf": "a BUSMASTER database, which BUSMASTER exports as DBC",
    ".xlsx": "a spreadsheet",
    ".xls": "a spreadsheet",
}
_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


def find_database(issues: ConfigIssues, value: object, folder: Path) -> Path | None:
    """Return the file of a rig's key `dbc`, beside the rig or shipped; None and an issue if there is none."""
    name = text(issues, "dbc", value)
    if not name:
        return None
    for path in (folder / name, data_root() / "dbc" / name):
        if is_there(path):
            return path
    issues.add("dbc", f"{show(name)}: no such file beside the rig or among the shipped ones")
    return None


# Where each format states start and length of signals [bits] and length of messages [bytes].
_PLACES = {
    ".dbc": r"^[ \t]*SG_[ \t][^:\n]*:[ \t]*(\d+)[ \t]*\|[ \t]*(\d+)"
    r"|^[ \t]*BO_[ \t][^:\n]*:[ \t]*(\d+)",
    ".kcd": r"\b(?:offset|length)\s*=\s*[\"'](\d+)",
    ".sym": r"^[ \t]*(?:Var|Mux)[ \t]*=[^\n]*?[ \t](\d+)[ \t]*,[ \t]*(\d+)"
    r"|^[ \t]*(?:Sig[ \t]*=[^\n]*?[ \t]|(?:DLC|Len)[ \t]*=[ \t]*)(\d+)",
    ".arxml": r"<(?:[\w-]+:)?START-POSITION>\s*(\d+)",
}
_MOST_BITS = 32_768  # the longest messages have 4095 bytes (first edition of ISO-TP)


def _out_of_place(written: str, kind: str) -> str:
    """Return the first place or length beyond _MOST_BITS; "" if there is none.

    The time that cantools takes grows with the square of such a number.
    """
    for found in re.finditer(_PLACES[kind], written, re.MULTILINE):
        numbers = [each for each in found.groups() if each]
        if any(len(each) > 9 or int(each) > _MOST_BITS for each in numbers):
            return " ".join(found.group().split())
    return ""


def load_messages(issues: ConfigIssues, path: Path) -> dict[str, Message]:
    """Return the messages of a database by name; its issues are noted under `dbc`."""
    from liftgate_hil.config.can_libraries import cantools

    kind = path.suffix.lower()
    try:
        raw = read_bytes(path)
        if kind not in KINDS:
            is_other = f"is {_OTHERS[kind]}; " if kind in _OTHERS else ""
            raise ConfigError(f"{path}: {is_other}allowed: a file of {', '.join(KINDS)}")
    except ConfigError as error:
        issues.add("dbc", str(error))
        return {}
    # cantools only logs what makes a database ambiguous; here it is an issue.
    try:
        written = "\n".join(raw.decode(_encoding(raw, kind)).splitlines()) + "\n"
        if wrong := _out_of_place(written, kind):
            raise ValueError(f"{wrong}: allowed: up to {_MOST_BITS} bits")
        database, warnings = _read(written, kind)
    except Exception as error:  # cantools passes on exceptions of any kind from its parsers
        text = " ".join(str(error).split())[:200] or type(error).__name__
        issues.add("dbc", f"{path}: cannot be read: {text}")
        return {}
    if not isinstance(database, cantools.database.can.Database):
        issues.add("dbc", f"{path}: allowed: a CAN database")
        return {}
    for each in warnings:
        if "Overwriting" in each:
            issues.add("dbc", f"{path}: ambiguous: {each}")
    if not database.messages:
        issues.add("dbc", f"{path}: has no messages; allowed: a CAN database with messages")
    _check_numbers(issues, path, database.messages)
    return {message.name: message for message in database.messages}


@functools.lru_cache(maxsize=4)
def _read(written: str, kind: str) -> tuple[Any, tuple[str, ...]]:
    """Return what cantools makes of a database's text, and its warnings.

    Kept, as cantools takes 10 ms and more each time, and one process runs many scenarios with the same database:
    messages are read, and never changed.
    """
    from liftgate_hil.config.can_libraries import cantools, logged

    with logged("cantools") as warnings:
        database = cantools.database.load_string(written, kind[1:])
    return database, tuple(warnings)


def _check_numbers(issues: ConfigIssues, path: Path, messages: Iterable[Message]) -> None:
    """Note factors, offsets, limits and label values that are too large for a float.

    In a database they may have any number of digits; a float holds 308.
    """
    for message in messages:
        for signal in message.signals:
            for what, value in (
                ("factor", signal.scale),
                ("offset", signal.offset),
                ("minimum", signal.minimum),
                ("maximum", signal.maximum),
                *(("a label of", raw) for raw in signal.choices or ()),
            ):
                # An infinite minimum or maximum means no limit.
                is_limit = what.endswith("imum") and isinstance(value, float) and not math.isnan(value)
                if value is None or is_limit or abs(value) <= sys.float_info.max:
                    continue
                issues.add(
                    "dbc", f"{path}: {message.name}.{signal.name}: {what} {show(value)}; allowed: up to 1.8e+308"
                )


def _encoding(raw: bytes, kind: str) -> str:
    """Return the encoding: that of a byte order mark, else UTF-8 if it is valid, else that of the format.

    Hardly any cp1252 text with letters beyond ASCII is valid UTF-8.
    """
    for mark, encoding in _MARKS.items():
        if raw.startswith(mark):
            return encoding
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError:
        return KINDS[kind]
    return "utf-8"

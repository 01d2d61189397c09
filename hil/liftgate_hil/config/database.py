"""Find and load the database that a rig names: DBC, ARXML, KCD or SYM, read by cantools."""

from __future__ import annotations

import codecs
from pathlib import Path
from typing import NamedTuple

from liftgate_hil.codec.messages import Messages
from liftgate_hil.config.database_content import content_of
from liftgate_hil.config.database_forms import OTHERS, form_of
from liftgate_hil.config.files import is_there, read_bytes
from liftgate_hil.config.shipped import data_root
from liftgate_hil.config.toml import show, text
from liftgate_hil.errors import ConfigError, ConfigIssues

# File suffix: encoding of files that are not UTF-8.
KINDS = {".dbc": "cp1252", ".arxml": "utf-8", ".kcd": "utf-8", ".sym": "cp1252"}
_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
_MOST_REASONS = 3  # why a file has no messages


class DatabaseFile(NamedTuple):
    """A database, and of one with several buses the bus that is meant; "": the only one."""

    path: Path
    bus: str = ""


def database_file(name: str | Path) -> DatabaseFile:
    """Return the database that FILE or FILE#BUS names."""
    file, _, bus = str(name).rpartition("#")
    if Path(name).suffix.lower() not in KINDS and Path(file).suffix.lower() in KINDS:
        return DatabaseFile(Path(file), bus)
    return DatabaseFile(Path(name))


def is_database(name: str | Path) -> bool:
    """Whether a name is that of a database, by its suffix."""
    return database_file(name).path.suffix.lower() in KINDS


def find_database(issues: ConfigIssues, value: object, folder: Path) -> DatabaseFile | None:
    """Return the file of a rig's key `dbc`, beside the rig or shipped; None and an issue if there is none."""
    name = text(issues, "dbc", value)
    if not name:
        return None
    given = database_file(name)
    for path in (folder / given.path, data_root() / "dbc" / given.path):
        if is_there(path):
            return given._replace(path=path)
    issues.add("dbc", f"{show(name)}: no such file beside the rig or among the shipped ones")
    return None


def load_messages(issues: ConfigIssues, file: DatabaseFile) -> Messages:
    """Return the messages of a database; its issues are noted under `dbc`.

    A message with a fault is no issue: it is left out.
    """
    path, kind = file.path, file.path.suffix.lower()
    try:
        raw = read_bytes(path)
        if kind not in KINDS:
            is_other = f"is {OTHERS[kind]}; " if kind in OTHERS else ""
            raise ConfigError(f"{path}: {is_other}allowed: a file of {', '.join(KINDS)}")
    except ConfigError as error:
        issues.add("dbc", str(error))
        return Messages()
    try:
        written = "\n".join(raw.decode(_encoding(raw, kind)).splitlines()) + "\n"
        buses = content_of(written, kind)
    except UnicodeDecodeError as error:
        why = f"cannot be read: no text in {error.encoding} from byte {error.start} on"
        issues.add("dbc", f"{path}: {form_of(raw, kind) or why}")
        return Messages()
    except ConfigError as error:
        issues.add("dbc", f"{path}: {form_of(raw, kind) or f'cannot be read: {error}'}")
        return Messages()
    if file.bus and file.bus not in buses:
        names = ", ".join(filter(None, buses)) or "none, as its bus has no name"
        issues.add("dbc", f"{path}: has no bus {show(file.bus)}; allowed: {names}")
        return Messages()
    if len(buses) > 1 and not file.bus:
        allowed = ", ".join(f"{path.name}#{bus}" for bus in buses)
        issues.add("dbc", f"{path}: holds several buses, {', '.join(buses)}; allowed: one of them: {allowed}")
        return Messages()
    found = buses[file.bus] if file.bus else next(iter(buses.values()))
    if not found:
        reasons = f"; {'; '.join(found.notes[:_MOST_REASONS])}" if found.notes else ""
        why = f"has no messages; allowed: a CAN database with messages{reasons}"
        issues.add("dbc", f"{path}: {form_of(raw, kind) or why}")
    return found


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

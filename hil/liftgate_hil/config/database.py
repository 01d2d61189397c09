"""Find and load the CAN database that a rig names: DBC, ARXML, KCD or SYM, read by cantools."""

from __future__ import annotations

import codecs
import re
from pathlib import Path
from typing import NamedTuple

from liftgate_hil.codec.messages import Messages
from liftgate_hil.config.database_content import content_of
from liftgate_hil.config.files import is_there, read_bytes
from liftgate_hil.config.shipped import data_root
from liftgate_hil.config.toml import show, text
from liftgate_hil.errors import ConfigError, ConfigIssues

# File suffix: encoding of files that are not UTF-8.
KINDS = {".dbc": "cp1252", ".arxml": "utf-8", ".kcd": "utf-8", ".sym": "cp1252"}
_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
_MOST_REASONS = 3  # why a file has no messages


class DatabaseFile(NamedTuple):
    """A database file, and the name of the bus to use if it has several; "": the only one."""

    path: Path
    bus: str = ""


def database_file(name: str | Path) -> DatabaseFile:
    """Return the database file, and the bus in it, of a text FILE or FILE#BUS."""
    file, _, bus = str(name).rpartition("#")
    if Path(name).suffix.lower() not in KINDS and Path(file).suffix.lower() in KINDS:
        return DatabaseFile(Path(file), bus)
    return DatabaseFile(Path(name))


def is_database(name: str | Path) -> bool:
    """Whether a file name has the suffix of a CAN database."""
    return database_file(name).path.suffix.lower() in KINDS


def find_database(issues: ConfigIssues, value: object, folder: Path) -> DatabaseFile | None:
    """Return the database file of a rig's key `dbc`, beside the rig or shipped; None and an issue: none found."""
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
        # A comment in another code page than cp1252 has bytes that it lacks, which no name has.
        lacking = "strict" if b"\0" in raw else "replace"
        written = "\n".join(raw.decode(_encoding(raw, kind), lacking).splitlines()) + "\n"
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
    """Return a database's encoding: by byte order mark, else UTF-8 if valid (cp1252 hardly is), or by format."""
    for mark, encoding in _MARKS.items():
        if raw.startswith(mark):
            return encoding
    try:
        raw.decode("utf-8")
    except UnicodeDecodeError:
        return KINDS[kind]
    return "utf-8"


# Suffixes of other databases that are named by mistake, and what such a file is.
OTHERS = {
    ".cdd": "a diagnostic database",
    ".odx": "a diagnostic database",
    ".pdx": "a diagnostic database",
    ".ldf": "a LIN database",
    ".a2l": "a calibration database",
    ".dbf": "a BUSMASTER database, which BUSMASTER exports as DBC",
    ".xlsx": "a spreadsheet",
    ".xls": "a spreadsheet",
}
_HEAD = 2048  # bytes that are looked at
_ROOT = rb"\s*(?:<[?!][^>]*>\s*)*<(?:\w+:)?"  # up to the name of the root of an XML
# How a file begins; what it is; its ending, if it is a database that is read.
_FORMS = (
    (rb"\s*LIN_description_file\b", OTHERS[".ldf"], ""),
    (rb".*\[DATABASE_VERSION\]", OTHERS[".dbf"], ""),
    (rb".*\bASAP2_VERSION\b", OTHERS[".a2l"], ""),
    (_ROOT + rb"(?:CANDELA|ODX)[\s>]", OTHERS[".odx"], ""),
    (_ROOT + rb"FIBEX[\s>]", "a FIBEX database", ""),
    (_ROOT + rb"html[\s>]", "a web page", ""),
    (rb"version https://git-lfs", "a Git LFS pointer instead of the file, which git lfs pull fetches", ""),
    (rb"PK\x03\x04", "a spreadsheet, or another ZIP archive", ""),
    (rb"\xD0\xCF\x11\xE0", OTHERS[".xls"], ""),
    (rb"\x1F\x8B", "compressed by gzip", ""),
    (_ROOT + rb"NetworkDefinition[\s>]", "a KCD", ".kcd"),
    (_ROOT + rb"AUTOSAR[\s>]", "an ARXML", ".arxml"),
    (rb"(?:.*\n)?FormatVersion=\d", "a SYM", ".sym"),
    (rb"(?:.*\n)?[ \t]*BO_[ \t]+\d+[ \t]+\w+[ \t]*:", "a DBC", ".dbc"),
)


def form_of(raw: bytes, kind: str) -> str:
    """Return as text which format a file of suffix `kind` has instead; "": none is recognized, or its own."""
    head = raw[:_HEAD].removeprefix(b"\xef\xbb\xbf")
    for begin, called, ending in _FORMS:
        if re.match(begin, head, re.DOTALL | re.IGNORECASE):
            allowed = f"a name that ends in {ending}" if ending else "a CAN database"
            return "" if ending == kind else f"is {called}; allowed: {allowed}"
    return ""

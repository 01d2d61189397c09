"""Forms of files in which no message could be read, by how they begin: another database, or no database."""

from __future__ import annotations

import re

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
    """Return what a file with the ending `kind` is, and what is allowed; "": no other than its ending says."""
    head = raw[:_HEAD].removeprefix(b"\xef\xbb\xbf")
    for begin, called, ending in _FORMS:
        if re.match(begin, head, re.DOTALL | re.IGNORECASE):
            allowed = f"a name that ends in {ending}" if ending else "a CAN database"
            return "" if ending == kind else f"is {called}; allowed: {allowed}"
    return ""

"""Files of other tools that have an ending of ours, by how they begin: named, with what to do."""

from __future__ import annotations

from pathlib import Path

from liftgate_hil.errors import ConfigError

_HEAD = 512  # bytes
_FROM_BUSMASTER = "exported there as ASC, or recorded with candump -L"
_FROM_SAVVYCAN = "saved by SavvyCAN in candump's form"
# How a file begins, or what stands in its first lines; what it is; what is allowed.
_FORMS = (
    (
        b"version https://git-lfs.github.com",
        "a Git LFS pointer instead of the file",
        "the file, after: git lfs pull",
    ),
    (b"***BUSMASTER", "a log of BUSMASTER", _FROM_BUSMASTER),
    (b"@ TEXT @", "a trace of CAR BUS Analyzer", "exported there as ASC or CSV"),
    (b"Time Stamp,ID,Extended", "a log of SavvyCAN", _FROM_SAVVYCAN),
    (b"ID,Data Bytes", "a log of SavvyCAN without times", _FROM_SAVVYCAN),
    (b"\x1f\x8b", "compressed by gzip", "unpacked"),
    (b"PK\x03\x04", "a ZIP archive", "unpacked"),
)
# And with which endings.
_WITHIN = (
    (b"Microchip", "a log of Microchip's CAN BUS Analyzer", "converted into candump's form or ASC", (".log",)),
    # A part of a log of BUSMASTER, without its first lines.
    (b"***<Time><Tx/Rx>", "a log of BUSMASTER", _FROM_BUSMASTER, (".log",)),
    # The record with the version, in the Car Reverse-Engineering Toolkit's format.
    (b" CXX ", "a CRTD log", _FROM_SAVVYCAN, (".txt", ".csv", ".log")),
)
_MDF, _MDF_VERSION = (b"MDF     ", b"UnFinMF "), slice(8, 12)
# What a binary format begins with, and its endings.
_BINARY = (
    (b"LOGG", "BLF", (".blf",)),
    *((begin, "MDF", (".mf4",)) for begin in _MDF),
    (b"\x89MCAP", "MCAP", (".mcap",)),
)


def check_form(path: Path) -> None:
    """Raise ConfigError if a file is one of another kind than its ending says, as far as its beginning tells.

    Also raises it for versions of MDF that are not read.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
    for begin, called, allowed in _FORMS:
        if head.removeprefix(b"\xef\xbb\xbf").startswith(begin):
            raise ConfigError(f"{path}: is {called}; allowed: {allowed}")
    for part, called, allowed, suffixes in _WITHIN:
        if part in head and path.suffix.lower() in suffixes:
            raise ConfigError(f"{path}: is {called}; allowed: {allowed}")
    version = head[_MDF_VERSION].decode("latin-1").strip(" \0")
    if head.startswith(_MDF) and version[:1] in ("2", "3"):
        raise ConfigError(
            f"{path}: MDF {version}; allowed: MDF 4, to which asammdf converts it: "
            f"MDF({path.name!r}).convert('4.10').save('{path.stem}-4.mf4')"
        )
    for begin, called, suffixes in _BINARY:
        if head.startswith(begin) and path.suffix.lower() not in suffixes:
            raise ConfigError(f"{path}: is {called}; allowed: a name that ends in {suffixes[0]}")

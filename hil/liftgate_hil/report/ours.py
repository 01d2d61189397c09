"""Reports and pictures of this program, told from other content by what they hold."""

from __future__ import annotations

import json
from pathlib import Path

from liftgate_hil.report.page import GENERATOR

SOFTWARE = "liftgate-hil"  # what pictures name as the program that made them
JUNIT = "<!-- JUnit XML of liftgate-hil -->"  # before JUnit's root element, which has no attributes
_HEAD = 2000  # bytes in which these stand, but for a PDF's
_MARKS = (GENERATOR, JUNIT, f"Software\0{SOFTWARE}", f"<dc:title>{SOFTWARE}</dc:title>")
_PDF = f"/Creator ({SOFTWARE})"


def is_ours(path: Path) -> bool:
    """Whether a file is a report or a picture of this program; false if nobody can tell."""
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD)
            if head.startswith(b"%PDF"):
                return _PDF.encode() in head + stream.read()
            if head.lstrip().startswith(b"{"):
                return _is_our_json(head + stream.read())
    except OSError:
        return False
    return any(mark.encode() in head for mark in _MARKS)


_BEGINS = {".html": b"<!doctype", ".xml": b"<?xml", ".json": b"{"}  # how reports of ours begin, by suffix


def holds_form(path: Path, suffix: str) -> bool:
    """Whether a report has the form of a suffix; true for one that has no beginning of its own."""
    with path.open("rb") as stream:
        return stream.read(_HEAD).lstrip().lower().startswith(_BEGINS.get(suffix, b""))


def _is_our_json(content: bytes) -> bool:
    """Whether JSON has a provenance with the version of this program."""
    try:
        return "liftgate-hil" in json.loads(content)["provenance"]["versions"]
    except (ValueError, LookupError, TypeError, RecursionError):
        return False

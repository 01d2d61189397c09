"""Markdown table of the keys of a file's table, from the schema by which such files are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from liftgate_hil.config.described import fields_of
from tools.docs.markdown import code, table

_HEADS = ("key", "allowed", "default", "meaning")


def key_table(record: type, allowed: Mapping[str, str] | None = None) -> str:
    """Return the table of a record's keys; `allowed` replaces, by key, the allowed values that the kind states."""
    return table(_HEADS, _rows(record, allowed or {}))


def a_range(allowed: str) -> str:
    """Return allowed values as a table shows them: the words after "one of" as code."""
    if allowed.startswith("one of "):
        return ", ".join(f"`{each}`" for each in allowed.removeprefix("one of ").split(", "))
    return allowed


def _rows(record: type, allowed: Mapping[str, str]) -> Iterator[tuple[str, ...]]:
    for key in fields_of(record):
        yield code(key.name), allowed.get(key.name) or a_range(key.kind.allowed), key.default_text, key.meaning

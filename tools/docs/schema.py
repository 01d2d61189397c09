"""Markdown table of the keys of a file's table, from the schema by which such files are read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from liftgate_hil.config.schema import Key
from tools.docs.checker import a_range
from tools.docs.markdown import code, table

_HEADS = ("key", "allowed", "default", "meaning")


def key_table(of: Sequence[Key], allowed: Mapping[str, str] | None = None) -> str:
    """Return the table of keys; `allowed` replaces, by key, the allowed values that the key's kind states."""
    return table(_HEADS, _rows(of, allowed or {}))


def default_of(key: Key) -> str:
    """Return the default of a key in words; "" if it is an empty list."""
    return "" if key.default == () else key.default_told


def _rows(of: Sequence[Key], allowed: Mapping[str, str]) -> Iterator[tuple[str, ...]]:
    for key in of:
        what = allowed.get(key.name) or a_range(key.kind.allowed)
        yield code(key.name), what, default_of(key), key.meaning

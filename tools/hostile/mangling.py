"""Random mangling of texts, bytes, trees of values, and of files themselves."""

from __future__ import annotations

import copy
import os
import random
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

NUMBERS = (
    "0", "1", "-1", "7", "64", "65", "255", "4294967296", "1e306", "-1e306", "5e-324", "1e400", "nan", "inf",
    "-inf", "1" + "0" * 400, "0x10", "1_000", "1.", ".5", "1,5", "１",
)  # fmt: skip
_TIMES = (1, 1, 1, 2, 4)  # numbers of changes of a file to choose from; of many, a call only gets to the first
_SIGNS = "0123456789-+|@()[]{}\",.'=#$ MmZ:;xé\t\0\x1b\x7f"
_REMOVE = object()
VALUES: list[Any] = [
    _REMOVE, True, False, -1, 0, 1, 2.5, float("nan"), float("inf"), -float("inf"), 10**400, 1e300, -1e300, 1e-300,
    5e-324, "", "x", "nan", "open", "closed", "ä\n", "\u0007\u202e", "a" * 300, "../..", "/dev/zero", "$x", "$",
    [], [1], [[]], [[1, 2]], [[0, 1], [1, 2]], [{}], {}, {"a": 1}, {"": 1}, [[[[[[1]]]]]],
]  # fmt: skip


def literal(value: Any) -> str:
    """Return a value as TOML text."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        escaped = "".join(
            each if each >= " " and each not in '"\\\x7f' else f"\\u{ord(each):04x}" for each in value
        )
        return f'"{escaped}"'
    if isinstance(value, list):
        return "[" + ", ".join(map(literal, value)) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{literal(k)} = {literal(v)}" for k, v in value.items()) + "}"
    return repr(value)


def document(content: dict[str, Any]) -> str:
    """Return a tree of values as a TOML document."""
    return "".join(f"{literal(key)} = {literal(value)}\n" for key, value in content.items())


def slots(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yield every place of a value in a tree, as (container, key)."""
    if isinstance(value, dict | list):
        for key in list(value) if isinstance(value, dict) else range(len(value)):
            yield value, key
            yield from slots(value[key])


def tree(chance: random.Random, content: dict[str, Any], words: list[str]) -> dict[str, Any]:
    """Return a copy of a tree with some values changed, moved, removed, or under other keys."""
    content = copy.deepcopy(content)
    for _ in range(chance.choice(_TIMES)):
        places = list(slots(content))
        if not places:
            break
        container, key = chance.choice(places)
        other, at = chance.choice(places)
        now = container[key]
        is_number = isinstance(now, int | float) and abs(now) < 1e200
        near = [now * factor for factor in (-1, 0.1, 3, 1000)] if is_number else []
        value = chance.choice([*VALUES, *near * 4, *[other[at]] * 8, chance.choice(words)])
        if value is _REMOVE:
            del container[key]
        elif isinstance(container, dict) and chance.random() < 0.15:
            container[chance.choice(["x", "", "a.b", *words])] = copy.deepcopy(value)
        else:
            container[key] = copy.deepcopy(value)
    return content


def lines(chance: random.Random, text: str, words: list[str]) -> str:
    """Return a text with some lines changed, removed, repeated, exchanged or cut off."""
    rows = text.split("\n")
    for _ in range(chance.choice(_TIMES)):
        at = chance.randrange(len(rows))
        row = rows[at]
        kind = chance.randrange(7)
        if kind == 0 and len(rows) > 1:
            del rows[at]
        elif kind == 1:
            rows.insert(at, chance.choice(rows))
        elif kind == 2 and row:
            place = chance.randrange(len(row))
            rows[at] = row[:place] + chance.choice(_SIGNS) + row[place + chance.randint(0, 1) :]
        elif kind == 3 and (digits := re.findall(r"[0-9.e+-]*[0-9][0-9.e+-]*", row)):
            rows[at] = row.replace(chance.choice(digits), chance.choice(NUMBERS), 1)
        elif kind == 4 and (names := re.findall(r"\w+", row)):
            rows[at] = row.replace(chance.choice(names), chance.choice(words), 1)
        elif kind == 5:
            other = chance.randrange(len(rows))
            rows[at], rows[other] = rows[other], row
        elif kind == 6 and row:
            rows[at] = row[: chance.randrange(len(row))]
    return "\n".join(rows)


def content(chance: random.Random, raw: bytes) -> bytes:
    """Return bytes with some of them changed, removed or inserted, or in another text encoding."""
    kind = chance.randrange(8)
    if kind == 0:
        return raw[: chance.randrange(len(raw) + 1)]
    if kind == 1:
        return raw[chance.randrange(len(raw) + 1) :]
    if kind == 2:
        return b"\xef\xbb\xbf" + raw
    if kind == 3:
        return raw.replace(b"\n", chance.choice([b"\r\n", b"\r", b"\n\n", b"\0", b""]))
    if kind == 4:
        return raw.decode("utf-8", "replace").encode(chance.choice(["utf-16", "utf-16-le", "utf-32"]))
    changed = bytearray(raw)
    for _ in range(chance.choice([1, 3, 30])):
        at = chance.randrange(len(changed) + 1)
        part = bytes(chance.randrange(256) for _ in range(chance.choice([1, 4, 16])))
        changed[at : at + chance.choice([0, len(part)])] = part
    return bytes(changed)


def no_file(chance: random.Random, path: Path) -> tuple[str, str]:
    """Create something at `path` that is no usable file, or choose a name that no such file has.

    Returns (the name for the call, what it is).
    """
    kind = chance.randrange(9)
    if kind == 0:
        path.mkdir()
        return path.name, "a folder"
    if kind == 1:
        os.mkfifo(path)
        return path.name, "a FIFO"
    if kind == 2:
        path.symlink_to(path.name)
        return path.name, "a link to itself"
    if kind == 3:
        path.symlink_to("nowhere")
        return path.name, "a link to nothing"
    if kind == 4:
        return "n" * 300 + path.suffix, "a name too long"
    if kind == 5:
        return f"no/{path.name}", "no such folder"
    if kind == 6:
        return "", "no name"
    if kind == 7:
        path.write_bytes(b"")
        return path.name, "an empty file"
    return "/dev/zero", "a device"

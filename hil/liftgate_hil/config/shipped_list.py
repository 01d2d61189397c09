"""List of the shipped files that flags may name, with descriptions: scenarios, vehicles, rigs, campaigns."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

from liftgate_hil.config.shipped import CAMPAIGNS, KINDS, PACK, shipped_files
from liftgate_hil.config.toml import read_toml

_COMMENT = re.compile(r"\A(?:# ?.*\n)+")
_SENTENCE_END = re.compile(r"[.:;](?=\s|$)")


class Shipped(NamedTuple):
    """Something shipped: its kind in the plural, its name as a flag takes it, and its description.

    A name is that of a file, or SET/NAME of one in a set of scenarios.
    """

    kind: str
    name: str
    description: str


def shipped_list() -> list[Shipped]:
    """Return all shipped files, by kind and name."""
    return [
        Shipped(kind, f"{PACK if kind == CAMPAIGNS else ''}{name}", _description(path))
        for kind in KINDS
        for name, path in shipped_files(kind).items()
    ]


def _description(path: Path) -> str:
    """Return the description in a shipped file, or the first sentence of the comment with which it begins."""
    description = read_toml(path).get("description")
    if description:
        return " ".join(str(description).split())
    comment = _COMMENT.match(path.read_text(encoding="utf-8"))
    text = " ".join(line.removeprefix("#").strip() for line in comment[0].splitlines()) if comment else ""
    return _SENTENCE_END.split(text, maxsplit=1)[0]

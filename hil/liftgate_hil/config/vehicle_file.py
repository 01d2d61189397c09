"""Change values in a vehicle file; its comments and order are kept."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from liftgate_hil.config.settings import Setting, apply_setting
from liftgate_hil.config.toml import read_text, read_toml
from liftgate_hil.config.vehicle_keys import SIDES

_COORDINATE = re.compile(r"(.+)\[([01])\]")


def vehicle_text(
    source: Path, settings: Sequence[Setting], values: Mapping[str, float], origin: Mapping[str, Any]
) -> str:
    """Return the text of `source` with `settings` and `values` (by their dotted names) applied.

    `origin` becomes the table `[identification]`, which states the provenance of the values.
    """
    import tomlkit

    read_toml(source)  # raises ConfigError if it is invalid
    document: Any = tomlkit.parse(read_text(source))
    for setting in settings:
        apply_setting(document, setting)
    for name, value in values.items():
        _put(document, name, value)
    document.pop("identification", None)
    document["identification"] = dict(origin)
    text: str = tomlkit.dumps(document)
    return text


def _put(document: Any, name: str, value: float) -> None:
    """Set one value, also in the table of a drive that has that key itself."""
    match = _COORDINATE.fullmatch(name)
    names = (match[1] if match else name).split(".")
    places = [names]
    if names[0] not in SIDES:
        places += [[side, *names] for side in SIDES if _has(document, [side, *names])]
    for path in places:
        table = document
        for key in path[:-1]:
            table = table.setdefault(key, {})
        if match:
            table[path[-1]][int(match[2])] = value
        else:
            table[path[-1]] = value


def _has(document: Any, path: Sequence[str]) -> bool:
    for key in path:
        if not isinstance(document, Mapping) or key not in document:
            return False
        document = document[key]
    return True

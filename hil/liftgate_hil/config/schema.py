"""Schema of the tables in files: a table is read into a record, whose annotated fields are the table's keys.

Files are validated by these records, and the documentation is made from them.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Self, TypeVar, get_type_hints

from liftgate_hil.config.kinds import Kind
from liftgate_hil.config.toml import Table, known_keys, number, show
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.stimuli.moments import START, Instant

LATEST = 1e6  # s
_UNITS = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "min": 60.0}
_TIME = re.compile(rf"\s*(\d+(?:\.\d+)?)\s*({'|'.join(_UNITS)})?\s*")  # a time in quotes, which is no condition


class When:
    """A time or a condition."""

    allowed, invalid = f"0 to {LATEST:g} s, or a condition", START

    def read(self, issues: ConfigIssues, key: str, value: Any) -> Instant:
        """Return the instant; an issue if it is neither a time nor a condition."""
        if isinstance(value, str) and (time := _TIME.fullmatch(value)):
            seconds = float(time[1]) * _UNITS[time[2] or "s"]
            issues.add(key, f"{show(value)}; allowed: a number of seconds without quotes, such as {seconds:g}")
            return self.invalid
        if isinstance(value, str) and value.strip():
            return Instant(math.nan, value, key=key, source=issues.source)
        if isinstance(value, bool) or not isinstance(value, int | float):
            issues.add(key, f"{show(value)}; allowed: {self.allowed}")
            return self.invalid
        return Instant(number(issues, key, value, 0.0, LATEST, "s, or a condition"))


REQUIRED = object()


class Key(NamedTuple):
    """A key of a table.

    As the annotation of a record's field it states kind, meaning and, where the value itself does not show it, the
    default in words (`default_words`); `keys_of` adds name and default of the field.
    """

    kind: Kind
    meaning: str
    default_words: str = ""
    name: str = ""
    default: Any = REQUIRED

    @property
    def default_text(self) -> str:
        """The default in words."""
        if self.default_words:
            return self.default_words
        if self.default is REQUIRED:
            return "required"
        if self.default is None or self.default == ():
            return ""
        if isinstance(self.default, bool):
            return str(self.default).lower()
        return f"{self.default:g}" if isinstance(self.default, float) else str(self.default)


class Record:
    """Base class of the records that tables are read into.

    An annotated field of a subclass is a key of its table; a field without a value is required. Subclasses are no
    dataclasses: to create one takes as long as to import a file, and is done at every start.
    """

    def __init__(self, **values: Any) -> None:
        self.__dict__.update(values)

    def replaced(self, **values: Any) -> Self:
        """Return the record with other values."""
        return type(self)(**{**self.__dict__, **values})


Read = TypeVar("Read", bound=Record)


@functools.cache
def keys_of(record: Any) -> tuple[Key, ...]:
    """Return the keys of a table that is read into `record`, in the order of its fields."""
    return tuple(
        hint.__metadata__[0]._replace(name=name, default=getattr(record, name, REQUIRED))
        for name, hint in get_type_hints(record, include_extras=True).items()
    )


def read_record(issues: ConfigIssues, prefix: str, given: Table, record: Callable[..., Read]) -> Read:
    """Return a table as a record; issues are noted, and values that have them are `invalid` of their kind."""
    return record(**read_values(issues, prefix, given, keys_of(record)))


def read_values(issues: ConfigIssues, prefix: str, given: Table, keys: Sequence[Key]) -> dict[str, Any]:
    """Return the values of a table by its keys; issues are noted, for a missing key no others."""
    known_keys(issues, prefix, given, [key.name for key in keys])
    found: dict[str, Any] = {}
    for key in keys:
        place = dotted(prefix, key.name)
        if key.name in given:
            found[key.name] = key.kind.read(issues, place, given[key.name])
        elif key.default is REQUIRED:
            issues.add(place, f"missing; allowed: {key.kind.allowed}")
            issues.settle(place)
            found[key.name] = key.kind.invalid
        else:
            found[key.name] = key.default
    return found


def dotted(prefix: str, name: str) -> str:
    """Return the dotted key of a table's key; the prefix of a file itself is empty."""
    return f"{prefix}.{name}" if prefix else name

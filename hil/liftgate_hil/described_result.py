"""Description of a result's fields, once, from which its JSON, the reference page and its tables are made.

    @dataclass(frozen=True)
    class Fit(DescribedResult):
        name: str  # not in JSON
        percent: Annotated[float, Shown("NRMSE fit [%]")]

        @property
        def is_good(self) -> Annotated[bool, Shown("whether it is above 80 %")]: ...

`Fit("a", 90.0).to_dict()` is {"percent": 90.0, "is_good": True}. A TypedDict is described in the same way.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType, UnionType
from typing import Annotated, Any, ClassVar, NamedTuple, get_args, get_origin, get_type_hints, is_typeddict


class Shown(NamedTuple):
    """Annotation of a result's field or property that is public: its description for JSON and reference.

    `keys` of an object whose keys vary: what stands for them in the reference, and the meaning of the values, from
    the outside in. Items of a sequence are shown as such an object `by` one of their attributes.
    """

    meaning: str
    key: str = ""  # in JSON, where it is not called as the field
    keys: Mapping[str, str] = MappingProxyType({})
    by: str = ""
    is_flat: bool = False  # the keys of an object stand beside the others
    prefix: str = ""  # the same, and what they begin with
    parts: Mapping[str, str] = MappingProxyType({})  # meanings of what is in a value whose type states none itself


class Column(NamedTuple):
    """Annotation of a result's field or property that is a column of tables, on the terminal and in HTML.

    `cell` makes the text for a result. `look` is the column's CSS class; "r": numbers, at the right.
    """

    head: str
    cell: Callable[[Any], str]
    look: str = "r"
    longest: int = 1000  # characters on the terminal


class DescribedResult:
    """Base class of results: fields and properties marked as `Shown` are public, in JSON and the reference."""

    _asks: ClassVar[str] = ""  # what a caller compares where the result has no truth value

    def __bool__(self) -> bool:
        """Return True; raises TypeError where a failure would count as true, too."""
        if self._asks:
            raise TypeError(f"a {type(self).__name__} is neither true nor false; allowed: {self._asks}")
        return True

    def to_dict(self) -> dict[str, Any]:
        """Return the public fields as plain values by key; a number that is not finite is None."""
        return _object_of(self)

    def to_json(self, indent: int | None = None) -> str:
        """Return the result as JSON, as `--json` prints it: on one line, or with an indent."""
        import json  # which takes 2 ms of the start of commands that print none

        return json.dumps(self.to_dict(), indent=indent, allow_nan=False)


_SHOWN: dict[type, dict[str, tuple[Any, Shown]]] = {}  # of classes that have been asked for
_COLUMNS: dict[type, dict[str, Column]] = {}  # of the same


def shown_in(record: type) -> dict[str, tuple[Any, Shown]]:
    """Return type and description of a class's public fields, then properties, by attribute name."""
    if record not in _SHOWN:
        hints = get_type_hints(record, include_extras=True)
        for base in reversed(record.__mro__):
            for name, member in vars(base).items():
                if isinstance(member, property) and member.fget is not None:
                    hints[name] = get_type_hints(member.fget, include_extras=True)["return"]
        described = {name: hint for name, hint in hints.items() if get_origin(hint) is Annotated}
        _SHOWN[record] = {
            name: (hint.__origin__, found)
            for name, hint in described.items()
            if isinstance(found := hint.__metadata__[0], Shown)
        }
        _COLUMNS[record] = {
            name: hint.__metadata__[-1]
            for name, hint in described.items()
            if isinstance(hint.__metadata__[-1], Column)
        }
    return _SHOWN[record]


def columns_in(record: type, *names: str) -> list[Column]:
    """Return the columns of a class's fields and properties with these names, in this order."""
    shown_in(record)
    return [_COLUMNS[record][name] for name in names]


def _object_of(record: Any) -> dict[str, Any]:
    """Return the public fields of a result, or of a NamedTuple, as plain values by key."""
    found: dict[str, Any] = {}
    for name, (_, shown) in shown_in(type(record)).items():
        value = getattr(record, name)
        value = {getattr(each, shown.by): each for each in value} if shown.by else value
        has_parts = bool(shown.parts) and value is not None
        value = json_of({part: getattr(value, part) for part in shown.parts} if has_parts else value)
        if shown.is_flat:
            found |= value
        elif shown.prefix:
            found |= {f"{shown.prefix}_{key}": each for key, each in value.items()}
        else:
            found[shown.key or name] = value
    return found


def json_of(value: Any) -> Any:
    """Return a value in a form for JSON: results as dicts, arrays as lists; a number not finite is None."""
    if isinstance(value, DescribedResult):
        return value.to_dict()
    if isinstance(value, str | bool | int | None):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if hasattr(value, "tolist"):  # of numpy, which not every command loads
        return json_of(value.tolist())
    if isinstance(value, Mapping):
        return {str(key): json_of(each) for key, each in value.items()}
    if hasattr(value, "_fields") and shown_in(type(value)):
        return _object_of(value)
    return os.fspath(value) if isinstance(value, os.PathLike) else [json_of(each) for each in value]


def keys_of(record: type, own_tables: Sequence[type] = ()) -> dict[str, str]:
    """Return the meanings of all keys in the JSON of a class, by dotted path.

    `a.b` is key `b` of object `a`, `a[].b` that of each object in list `a`. The keys of `own_tables` are left
    out: they have tables of their own.
    """
    found: dict[str, str] = {}
    for name, (hint, shown) in shown_in(record).items():
        inner = _result_in(hint)
        if shown.is_flat:
            assert inner is not None
            found |= keys_of(inner, own_tables)
            continue
        if shown.prefix:
            assert inner is not None
            found |= {f"{shown.prefix}_{key}": f"{shown.meaning}: {text}" for key, text in keys_of(inner).items()}
            continue
        path = shown.key or name
        found[path] = shown.meaning
        items = f"{path}[]" if _is_list(hint) else path
        found |= {f"{items}.{part}": meaning for part, meaning in shown.parts.items()}
        for part, meaning in shown.keys.items():
            path = f"{path}.{part}"
            found[path] = meaning
        if inner is None or inner in own_tables:
            continue
        path += "" if shown.keys or not _is_list(hint) else "[]"
        found |= {f"{path}.{key}": meaning for key, meaning in keys_of(inner, own_tables).items()}
    return found


def _is_list(hint: Any) -> bool:
    """Whether a type hint is a list or tuple, or a union or annotation of one."""
    return any(get_origin(each) is tuple or get_origin(each) is list for each in (hint, *get_args(hint)))


def _result_in(hint: Any) -> type | None:
    """Return the class of results that a type hint is or contains; None: there is none."""
    if isinstance(hint, type) and get_origin(hint) is None:
        is_ours = issubclass(hint, DescribedResult) or hasattr(hint, "_fields") or is_typeddict(hint)
        return hint if is_ours and shown_in(hint) else None
    if get_origin(hint) in (Annotated, UnionType) or get_args(hint):
        return next(filter(None, map(_result_in, get_args(hint))), None)
    return None

"""Single description of a field, from which file readers, arguments, flags and reference pages are made.

A record is a class whose annotated fields each have a Field: the keys of a table in a file, the options of a run,
the arguments of a command.

    class RodTable(Record):
        angle_deg: Annotated[float, Field(Number(-10.0, 180.0, "deg"), "gate angle at which the gate meets it")]
        stiffness: Annotated[float, Field(Number(1.0, 1e7, "N/m"), "stiffness of its spring")] = 10_000.0

Modules with records must not have `from __future__ import annotations`, as texts would be compiled at each start.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping, Sequence
from numbers import Integral, Real
from typing import (
    Any,
    NamedTuple,
    ParamSpec,
    Protocol,
    Self,
    TypeVar,
    cast,
    dataclass_transform,
    get_args,
    overload,
)

from liftgate_hil.config.kinds import SEED, Kind, Number
from liftgate_hil.config.toml import Table, known_keys, shortened, show
from liftgate_hil.errors import ConfigError, ConfigIssues

REQUIRED = object()
_LONG = 500  # characters of a value's text
_PLAIN = (bool, int, float, str, list, tuple, dict, type(None))  # of a number `Real` asks all of numpy's classes
P = ParamSpec("P")  # the arguments of a command
Request_contra = TypeVar("Request_contra", contravariant=True)
Result_co = TypeVar("Result_co", covariant=True)


class Field(NamedTuple):
    """Description of a field of a record, such as a key of a file, or an option or argument of a command.

    As the annotation of a record's field it states kind and meaning; where the value itself does not show it, the
    default in words; for a flag, what stands for its value in the help, the field together with which it is
    allowed, what it is called where that is no name in Python (`from`), and other spellings (`-b`). `fields_of`
    adds what the class states: name, default, and whether None is allowed.
    """

    kind: Kind
    meaning: str
    default_words: str = ""
    metavar: str | None = None
    needs: str = ""
    flag: str = ""
    also: tuple[str, ...] = ()
    name: str = ""
    default: Any = REQUIRED
    may_be_none: bool = False

    @property
    def default_text(self) -> str:
        """The default of the field in words, or "required"; "": the default says nothing, as None does."""
        if self.default is REQUIRED and not self.default_words:
            return "required"
        if self.default_words or self.default is None or self.default == ():
            return self.default_words
        if isinstance(self.default, bool):
            return str(self.default).lower()
        return f"{self.default:g}" if isinstance(self.default, float) else str(self.default)

    def checked(self, value: object) -> Any:
        """Return the value of an argument, validated, in the record's unit and type. Raises ConfigError."""
        return None if value is None and self.may_be_none else value_of(self.name, value, self.kind)

    def is_given(self, value: object) -> bool:
        """Whether a value of the field differs from the default."""
        return bool(value != self.default)


@dataclass_transform(kw_only_default=True, frozen_default=True)
class Record:
    """Base class of records, whose annotated fields describe keys of a file or arguments of a command.

    A field without a value is required. Type checkers know the constructor as that of a dataclass; subclasses are
    none, as to create one takes as long as to import a file, and is done at every start. The constructor does not
    validate: `of` does. Of a class with `kw_only=False` it takes values by their place, too.
    """

    _takes_names_only = True

    def __init__(self, *placed: Any, **values: Any) -> None:
        self.__dict__.update(signature_of(type(self)).bind(*placed, **values).arguments)

    def __init_subclass__(cls, *, kw_only: bool = True) -> None:
        """Note whether the subclass's constructor takes its fields as keyword arguments only. Raises TypeError."""
        if any(isinstance(each, str) for each in _own_hints(cls).values()):
            raise TypeError(
                f"{cls.__name__}: annotations are texts; allowed: no `from __future__ import annotations`"
            )
        cls._takes_names_only = kw_only

    @classmethod
    def of(cls, *placed: Any, **given: Any) -> Self:
        """Return the record with these arguments, validated one by one and together.

        Raises ConfigError, and TypeError for arguments that do not fit the fields.
        """
        return cls(*placed, **given).validated()

    def validated(self) -> Self:
        """Return a copy of the record with each value validated and converted by its kind. Raises ConfigError."""
        fields = {each.name: each for each in fields_of(type(self))}
        found = type(self)(**{name: fields[name].checked(value) for name, value in vars(self).items()})
        found.check()
        return found

    def check(self) -> None:
        """Validate each value, and that those that a given value `needs` are given too. Raises ConfigError."""
        fields = {each.name: each for each in fields_of(type(self))}
        given = {
            name: value
            for name, field in fields.items()
            if field.is_given(value := field.checked(getattr(self, name)))
        }
        for name, value in given.items():
            needed = fields[name].needs
            if needed and needed not in given:
                text = f"{value:g}" if isinstance(value, float) else str(value)
                text = ", ".join(map(str, value)) if isinstance(value, tuple) else text
                text = "" if value is True else f" {text}"
                raise ConfigError(f"`{name}`{text}: allowed: together with `{needed}`")

    def replaced(self, **values: Any) -> Self:
        """Return a copy of the record with other values of some fields, which are not validated."""
        return type(self)(**{**self.__dict__, **values})

    def shared_with(self, other: type[Record]) -> dict[str, Any]:
        """Return the values of the fields that this record has in common with another class of records."""
        own = {each.name for each in fields_of(type(self))}
        return {each.name: getattr(self, each.name) for each in fields_of(other) if each.name in own}

    def to_dict(self) -> dict[str, Any]:
        """Return the values of all fields of the record, by name."""
        return {each.name: getattr(self, each.name) for each in fields_of(type(self))}

    def __eq__(self, other: object) -> bool:
        """Whether another record is of the same class and has the same values."""
        return isinstance(other, Record) and type(self) is type(other) and self.to_dict() == other.to_dict()

    def __hash__(self) -> int:
        """Return the hash of class and values. Raises TypeError where a value, such as a table, has none."""
        return hash((type(self), *self.to_dict().values()))

    def __repr__(self) -> str:
        """Return the class name and non-default values; in place of a value's long text, the name of its type."""
        fields = {each.name: each for each in fields_of(type(self))}
        given = {name: getattr(self, name) for name in signature_of(type(self)).parameters}
        texts = {name: repr(value) for name, value in given.items() if fields[name].is_given(value)}
        shown = [
            f"{name}={text if len(text) <= _LONG else type(given[name]).__name__}" for name, text in texts.items()
        ]
        return f"{type(self).__name__}({', '.join(shown)})"


Read = TypeVar("Read", bound=Record)


def _own_hints(record: type) -> Mapping[str, Any]:
    """Return the annotations of a class without those of its bases."""
    found: Mapping[str, Any] = vars(record).get("__annotations__", {})
    return found


_FIELDS: dict[type, tuple[Field, ...]] = {}  # of records that have been asked for


def fields_of(record: type) -> tuple[Field, ...]:
    """Return the fields of a record, in their order."""
    if record not in _FIELDS:
        hints = {name: hint for base in reversed(record.__mro__) for name, hint in _own_hints(base).items()}
        _FIELDS[record] = tuple(
            hint.__metadata__[0]._replace(
                name=name,
                default=getattr(record, name, REQUIRED),
                may_be_none=type(None) in get_args(hint.__origin__),
            )
            for name, hint in hints.items()
        )
    return _FIELDS[record]


_SIGNATURES: dict[type, inspect.Signature] = {}  # of records that have been asked for


def signature_of(record: type) -> inspect.Signature:
    """Return the signature of a function whose arguments are a record's fields.

    First those that are taken by their place, too; of either, first those that are required.
    """
    if record not in _SIGNATURES:
        found = []
        for each in fields_of(record):
            owner = next(one for one in record.__mro__ if each.name in _own_hints(one))
            names_only = vars(owner)["_takes_names_only"]
            kind = inspect.Parameter.KEYWORD_ONLY if names_only else inspect.Parameter.POSITIONAL_OR_KEYWORD
            default = inspect.Parameter.empty if each.default is REQUIRED else each.default
            place = 0 if names_only else list(owner.__annotations__).index(each.name)
            parameter = inspect.Parameter(each.name, kind, default=default)
            found.append((kind, each.default is not REQUIRED, place, parameter))
        found.sort(key=lambda each: each[:3])
        _SIGNATURES[record] = inspect.Signature([parameter for *_, parameter in found])
    return _SIGNATURES[record]


class CommandFunction(Protocol[P, Request_contra, Result_co]):
    """Public function of a command: accepts the fields of its request as arguments, or the request itself."""

    @overload
    def __call__(self, request: Request_contra, /) -> Result_co: ...

    @overload
    def __call__(self, *placed: P.args, **given: P.kwargs) -> Result_co: ...


def command(
    request: Callable[P, Request_contra],
) -> Callable[[Callable[[Request_contra], Result_co]], CommandFunction[P, Request_contra, Result_co]]:
    """Return a decorator: a function of a `request`, a class of records, also accepts its fields as arguments.

    The arguments are validated before the call, which raises ConfigError, and TypeError for arguments that do
    not fit. Signature and list of arguments in its docstring are those of the record.
    """
    record = cast(Any, request)

    def decorated(
        function: Callable[[Request_contra], Result_co],
    ) -> CommandFunction[P, Request_contra, Result_co]:
        def call(*placed: Any, **given: Any) -> Result_co:
            if len(placed) == 1 and not given and isinstance(placed[0], record):
                return function(placed[0].validated())
            try:
                asked = record(*placed, **given)
            except TypeError as error:
                raise TypeError(f"{function.__name__}() {error}") from None
            return function(asked.validated())

        functools.update_wrapper(call, function)
        vars(call)["__signature__"] = signature_of(record)
        call.__doc__ = f"{inspect.cleandoc(function.__doc__ or '')}\n\n{_arguments_text(record)}"
        return cast(CommandFunction[P, Request_contra, Result_co], call)

    return decorated


def _arguments_text(record: type) -> str:
    """Return the descriptions of a record's fields as the list of arguments in a docstring."""
    lines = []
    fields = {each.name: each for each in fields_of(record)}
    for each in map(fields.__getitem__, signature_of(record).parameters):
        default = f"; default: {each.default_text}" if each.default_text and each.default is not REQUIRED else ""
        meaning = each.meaning.removesuffix(" (repeatable)")
        lines.append(f"- `{each.name}`: {meaning}; allowed: {each.kind.allowed}{default}")
    return "\n".join(lines)


def value_of(name: str, value: object, kind: Kind) -> Any:
    """Return the value of an argument, validated and converted by its kind. Raises ConfigError."""
    given = value
    if type(value) not in _PLAIN and isinstance(value, Real):
        given = int(value) if isinstance(value, Integral) else float(value)
    issues = ConfigIssues("")
    # Records of the plant are tuples, too.
    found = kind.read(issues, name, list(given) if type(given) is tuple else given)
    if issues.count:
        is_plain = type(value) in (list, tuple)
        text = ", ".join(map(str, cast(list[object], value))) if is_plain else shortened(show(value))
        raise ConfigError(f"`{name}` {text}: allowed: {kind.allowed}")
    return found


def read_record(issues: ConfigIssues, prefix: str, given: Table, record: type[Read]) -> Read:
    """Return a table as a record; issues are noted, and invalid values replaced by the `invalid` of their kind."""
    return record(**read_values(issues, prefix, given, fields_of(record)))


def read_values(issues: ConfigIssues, prefix: str, given: Table, fields: Sequence[Field]) -> dict[str, Any]:
    """Return values, defaults or, where missing or wrong, `invalid`, by key; these and unknown keys are issues."""
    known_keys(issues, prefix, given, [each.name for each in fields])
    found: dict[str, Any] = {}
    for each in fields:
        place = dotted(prefix, each.name)
        if each.name in given:
            found[each.name] = each.kind.read(issues, place, given[each.name])
        elif each.default is REQUIRED:
            issues.add(place, f"missing; allowed: {each.kind.allowed}")
            issues.settle(place)
            found[each.name] = each.kind.invalid
        else:
            found[each.name] = each.default
    return found


def dotted(prefix: str, name: str) -> str:
    """Return the full dotted name of a key in the table `prefix`; of a key at the top level the name itself."""
    return f"{prefix}.{name}" if prefix else name


def number_of(name: str, value: object, low: float, high: float, unit: str) -> float:
    """Return a value as a number if it is one within [low, high]. Raises ConfigError."""
    return float(value_of(name, value, Number(low, high, unit)))


def seed_of(value: object, name: str = "seed") -> int:
    """Return a value as a seed of a random generator. Raises ConfigError."""
    return int(value_of(name, value, SEED))

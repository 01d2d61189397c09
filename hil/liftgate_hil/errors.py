"""Exceptions of this package, for users and for callers.

    LiftgateError
    ├── ConfigError          a file, a flag or a value: all issues of one source at once, exit code 2
    ├── TransportError       a bus that cannot be opened or is lost for good
    ├── RecordingError       a recording that could not be completed
    ├── OverrunError         the loop fell further behind than allowed
    ├── EcuError             the ECU under test did something forbidden, crashed or hung
    ├── DiagnosticsError     the ECU under test refused a diagnostic request, or did not answer it
    ├── RunGoneError         a run that was attached to has ended, or does not answer
    ├── PreconditionError    the precondition of a scenario was not reached
    └── PlantDivergedError   the plant's state is no longer finite or plausible

A bad frame on the bus raises none of these: it is counted, and the run goes on.

Names from files (keys, labels of a database, paths) may contain anything; messages contain unprintable characters
escaped, so that they cannot control a terminal.
"""

from __future__ import annotations

import os
import traceback
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import ClassVar, TypeVar

_T = TypeVar("_T")
MOST = 100  # lines that are reported, at most; the others are counted
_FEW = 12  # names that a message lists


def allowed_names(name: str, known: Iterable[str]) -> str:
    """Return as text the names allowed in place of an unknown one; of many, those most similar."""
    names = list(known)
    if len(names) <= _FEW:
        return ", ".join(names)
    return f"{', '.join(nearest(name, names) or names[:_FEW])}, … ({len(names)} in all)"


def nearest(name: str, known: Iterable[str], most: int = 3) -> list[str]:
    """Return at most `most` known names that begin with a name, contain it or are spelled alike; of "" none."""
    from difflib import get_close_matches  # takes as long as this file

    names, sought = list(known), name.lower()
    begin = [each for each in names if each.lower().startswith(sought)]
    contain = [each for each in names if sought in each.lower()]
    return list(dict.fromkeys([*begin, *contain, *get_close_matches(name, names, most)]))[:most] if sought else []


class Entries(dict[str, _T]):
    """Dictionary whose error on an unknown key lists the allowed ones, see `allowed_names`."""

    what: ClassVar[str]  # what a name names
    none: ClassVar[str]  # what is allowed where there are no entries

    def __missing__(self, name: str) -> _T:
        """Raise KeyError with the allowed keys."""
        __tracebackhide__ = True  # so that pytest shows the test's line
        allowed = allowed_names(str(name), self) if self else self.none
        raise KeyError(f"{name}: no such {self.what}; allowed: {allowed}")


def printable(text: str) -> str:
    """Return a text with control characters, line breaks and lone surrogates escaped as in Python."""
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in text)


def number_of(count: int, noun: str) -> str:
    """Return as text a count with its noun, in the plural unless it is one: 1 frame, 2 frames."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def with_unit(number: str, unit: str) -> str:
    """Return a number with its unit as text; "": a number without one."""
    return f"{number} {unit}" if unit else number


class LiftgateError(Exception):
    """Base class of all errors that this program raises on purpose."""

    def __init__(self, text: str = "") -> None:
        super().__init__("\n".join(printable(line) for line in text.split("\n")))


def causes(error: LiftgateError) -> list[str]:
    """Return the messages of an error and of the LiftgateErrors that led to it, oldest first."""
    earlier = error.__context__
    if isinstance(earlier, LiftgateError) and not error.__suppress_context__:
        return list(dict.fromkeys([*causes(earlier), str(error)]))
    return [str(error)]


class ConfigError(LiftgateError):
    """Raised for issues in the user's files, flags or values; `issues` has one line for each."""

    def __init__(self, issues: Sequence[str] | str) -> None:
        given = [issues] if isinstance(issues, str) else issues
        self.issues = [printable(issue) for issue in given]
        super().__init__("\n".join(self.issues))

    def __reduce__(self) -> tuple[type[ConfigError], tuple[list[str]]]:
        return ConfigError, (self.issues,)


class NotWrittenError(ConfigError):
    """Raised when a result's files could not be written; `result` is the result itself."""

    def __init__(self, issues: Sequence[str], result: object) -> None:
        super().__init__(issues)
        self.result = result

    def __reduce__(self) -> tuple[type[NotWrittenError], tuple[list[str], object]]:  # type: ignore[override]
        return NotWrittenError, (self.issues, self.result)


class PreconditionError(LiftgateError):
    """Raised when the precondition of a scenario is not reached, so that the scenario cannot be judged."""


class TransportError(LiftgateError):
    """Raised for a bus or serial port that cannot be opened, or is lost."""


class RunGoneError(LiftgateError):
    """Raised when a run that a command was attached to has ended, or does not answer."""


class RecordingError(LiftgateError):
    """Raised for a recording that could not be completed."""


class OverrunError(LiftgateError):
    """Raised when the loop has fallen too far behind, or lockstep has waited too long for a command."""


class EcuError(LiftgateError):
    """Raised when the ECU under test did something forbidden, raised, crashed or hung; `ticks`: when, if known."""

    def __init__(self, text: str, ticks: int = 0) -> None:
        self.ticks = ticks
        super().__init__(text)


class DiagnosticsError(LiftgateError):
    """Raised when the ECU refuses a diagnostic request (`nrc`: negative response code) or does not answer."""

    def __init__(self, text: str, nrc: int | None = None) -> None:
        self.nrc = nrc
        super().__init__(text)


class PlantDivergedError(LiftgateError):
    """Raised when the plant's state is no longer finite, exceeds its limits, or gains energy undriven."""

    @classmethod
    def at(cls, time: float, remedy: str = "a higher `rate`", found: str = "") -> PlantDivergedError:
        """Return the error for a model time [s]; `found` is the symptom, `remedy` the advice."""
        when = f"{round(float(time), 6):.12g} s"
        return cls(f"the plant diverged at {when}{found}; allowed: {remedy}, plausible vehicle parameters")


def text_of(error: BaseException) -> str:
    """Return the text of a foreign exception on one line; its `__str__` may fail, too.

    Backticks become apostrophes: in our messages they mark arguments, which the command line turns into flags.
    """
    try:
        return " ".join(str(error).split()).replace("`", "'")
    except Exception as other:
        return f"(its str raised {type(other).__name__})"


def words_of(error: BaseException) -> str:
    """Return the text of an error on one line, or its type's name if the text is empty."""
    return text_of(error) or type(error).__name__


def shown(value: object) -> str:
    """Return an object of foreign code as text for a message."""
    kind = type(value)
    if kind.__repr__ is object.__repr__:  # which contains an address in memory
        return f"an object of {kind.__module__}.{kind.__qualname__}"
    try:
        return repr(value)
    except Exception as error:
        return f"a {type(value).__name__} (its repr raised {type(error).__name__})"


class ConfigIssues:
    """Collector of the issues of one source, such as a file.

    `origins` maps keys that are not from that source to their names in messages.
    """

    def __init__(self, source: str, origins: Mapping[str, str] | None = None) -> None:
        self.source = source
        self.lines: list[str] = []
        self.unlisted = 0  # number of issues beyond MOST
        self._origins = dict(origins or {})
        self._settled: set[str] = set()

    def add(self, key: str, message: str) -> None:
        """Add an issue about a key, unless `settle` has suppressed the key's issues."""
        if key not in self._settled:
            self.take([f"{self.called(key)}: {message}"])

    def add_of(self, source: str, key: str, message: str) -> None:
        """Add an issue about a key of another source; "": of this source."""
        if source in ("", self.source):
            self.add(key, message)
        else:
            self.take([f"{source}: {key}: {message}"])

    def take(self, lines: Iterable[str]) -> None:
        """Add issues given as complete lines, each once; of more than MOST only the number is kept."""
        for line in lines:
            if line in self.lines:
                continue
            if len(self.lines) >= MOST:
                self.unlisted += 1
            else:
                self.lines.append(line)

    def settle(self, key: str) -> None:
        """Suppress further issues about a key, because its value's issues are reported elsewhere."""
        self._settled.add(key)

    def originate(self, key: str, called: str) -> None:
        """Set the name of a key in messages, because the key's value is not from this source."""
        self._origins[key] = called

    def unsettled(self, lines: Iterable[str]) -> list[str]:
        """Return those lines of issues of this source that are not about a settled key."""
        settled = tuple(f"{self.called(key)}: " for key in self._settled)
        return [line for line in lines if not line.startswith(settled)]

    @property
    def count(self) -> int:
        """Number of issues."""
        return len(self.lines) + self.unlisted

    def raise_if_any(self) -> None:
        """Raise ConfigError with all issues, if there are any."""
        if self.unlisted:
            raise ConfigError([*self.lines, f"{self.source}: and {self.unlisted} more issues"])
        if self.lines:
            raise ConfigError(self.lines)

    def called(self, key: str) -> str:
        """Return the name of a key in messages, with this source or the origin of the key's value."""
        for place, called in self._origins.items():
            if key == place or key.startswith((f"{place}.", f"{place}[")):
                return called + key[len(place) :]
        within = [called for place, called in self._origins.items() if place.startswith(f"{key}.")]
        also = f" (with {', '.join(within)})" if within else ""
        return f"{self.source}: {key}{also}"


def is_of_this_program(path: Path) -> bool:
    """Whether a file belongs to one of this program's own packages."""
    import liftgate_compiler
    import liftgate_plant

    own = {Path(__file__).resolve().parent}
    own |= {
        Path(each).resolve()
        for own_package in (liftgate_compiler, liftgate_plant)
        for each in own_package.__path__
    }
    return not own.isdisjoint(path.resolve().parents)


def place_of(error: BaseException) -> str:
    """Return as text where in the user's code an error was raised; "": nowhere there."""
    return place_in(traceback.extract_tb(error.__traceback__))


def place_in(calls: Sequence[traceback.FrameSummary]) -> str:
    """Return as text the innermost call, of several, that is in the user's code; "": none is.

    Calls of libraries and of this program are passed over.
    """
    for call in reversed(calls):
        path = Path(call.filename)
        if not (call.filename.startswith("<") or is_of_a_library(path) or is_of_this_program(path)):
            return f" ({path.name}, line {call.lineno})"
    return ""


def is_of_a_library(path: Path) -> bool:
    """Whether a file belongs to an installed package or to Python itself."""
    return bool({"site-packages", "dist-packages"} & {*path.parts}) or Path(os.__file__).parent in path.parents

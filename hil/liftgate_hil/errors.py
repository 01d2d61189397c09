"""What can go wrong, for users and for callers.

    LiftgateError
    ├── ConfigError          a file, a flag or a value: all faults of one source at once, exit code 2
    ├── TransportError       a bus that cannot be opened or is lost for good
    ├── RecordingError       a recording that could not be completed
    ├── OverrunError         the loop fell further behind than allowed
    ├── EcuError             the ECU under test did what none may, crashed or hung
    ├── DiagnosticsError     the ECU under test refused a diagnostic request, or did not answer it
    ├── RunGoneError         a run that was attached to has ended, or does not answer
    ├── PreconditionError    what goes before a scenario did not come to an end
    └── PlantDivergedError   the plant's state is no longer finite

A bad frame on the bus is none of these: it is counted and survived.

Names out of files (keys, labels of a database, paths) may hold anything; in a message whatever would not print as
itself stands escaped, so that no terminal obeys it.
"""

from __future__ import annotations

from collections.abc import Sequence


def printable(text: str) -> str:
    """The text with control characters, line breaks and lone surrogates escaped as in Python."""
    if text.isprintable():
        return text
    return "".join(
        each if each.isprintable() else each.encode("unicode_escape").decode() for each in text
    )


class LiftgateError(Exception):
    """Anything this program raises on purpose."""

    def __init__(self, text: str = "") -> None:
        super().__init__("\n".join(printable(line) for line in text.split("\n")))


def causes(error: LiftgateError) -> list[str]:
    """What it says, after what the one said that was on its way when it came."""
    earlier = error.__context__
    if isinstance(earlier, LiftgateError) and not error.__suppress_context__:
        return list(dict.fromkeys([*causes(earlier), str(error)]))
    return [str(error)]


class ConfigError(LiftgateError):
    """Faults in what the user gave; `issues` has one line for each."""

    def __init__(self, issues: Sequence[str] | str) -> None:
        given = [issues] if isinstance(issues, str) else issues
        self.issues = [printable(issue) for issue in given]
        super().__init__("\n".join(self.issues))

    def __reduce__(self) -> tuple[type[ConfigError], tuple[list[str]]]:
        return ConfigError, (self.issues,)


class PreconditionError(LiftgateError):
    """What goes before a scenario did not come to an end: nothing can be said of the scenario."""


class TransportError(LiftgateError):
    """A bus that cannot be opened, or is lost."""


class RunGoneError(LiftgateError):
    """A run that was attached to has ended, or does not answer."""


class RecordingError(LiftgateError):
    """A recording ended early; the run did not."""


class OverrunError(LiftgateError):
    """Too many periods in a row were missed."""


class EcuError(LiftgateError):
    """The ECU under test did what none may, raised, crashed or hung; after `ticks`, where that is known."""

    def __init__(self, text: str, ticks: int = 0) -> None:
        self.ticks = ticks
        super().__init__(text)


class DiagnosticsError(LiftgateError):
    """The ECU under test refused a diagnostic request, with that negative response code, or did not answer it."""

    def __init__(self, text: str, nrc: int | None = None) -> None:
        self.nrc = nrc
        super().__init__(text)


class PlantDivergedError(LiftgateError):
    """The plant's state is not finite."""


def text_of(error: BaseException) -> str:
    """What an error of foreign code says, whose own words may fail too."""
    try:
        return str(error)
    except Exception as other:
        return f"(its text: {type(other).__name__})"


def words_of(error: BaseException) -> str:
    """The same on one line; drivers break theirs, or say nothing at all."""
    return " ".join(text_of(error).split()) or type(error).__name__


def shown(value: object) -> str:
    """A foreign object as it may stand in a message."""
    kind = type(value)
    if kind.__repr__ is object.__repr__:  # which says where in memory it is
        return f"an object of {kind.__module__}.{kind.__qualname__}"
    try:
        return repr(value)
    except Exception as error:
        return f"a {type(value).__name__} (its repr: {type(error).__name__})"

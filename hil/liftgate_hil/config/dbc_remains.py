"""Reader of a DBC that cantools refuses: faulty statements and the messages that need them are left out."""

from __future__ import annotations

import bisect
import itertools
import re
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

from liftgate_hil.config.database_parts import (
    BLOCK,
    Remains,
    load_text,
    needs_29_bits,
    reason_of,
    refused,
    too_large,
)
from liftgate_hil.errors import printable

if TYPE_CHECKING:
    from cantools.database.can import Message

# Statements that end with a semicolon, and those that end where the next one begins.
_ENDED = (
    "BA_DEF_DEF_REL_", "BA_DEF_REL_", "BA_DEF_DEF_", "BA_DEF_SGTYPE_", "BA_DEF_", "BA_REL_", "BA_SGTYPE_", "BA_",
    "BO_TX_BU_", "CAT_DEF_", "CAT_", "CM_", "ENVVAR_DATA_", "EV_DATA_", "EV_", "FILTER", "SG_MUL_VAL_",
    "SGTYPE_VAL_", "SGTYPE_", "SIG_GROUP_", "SIG_TYPE_REF_", "SIG_VALTYPE_", "SIGTYPE_VALTYPE_", "VAL_TABLE_",
    "VAL_",
)  # fmt: skip
_OPEN = ("BO_", "SG_", "BU_", "BS_", "NS_", "VERSION")
_KEYWORD = rf"^[ \t]*(?:{'|'.join((*_ENDED, *_OPEN))})(?!\w)(?=[ \t]*\S)"
# A keyword alone on its line is one of the list of NS_.
_SCANNED = re.compile(rf'"(?:\\"|[^"])*"|//[^\n]*|;|{_KEYWORD}', re.MULTILINE)
_BEGINS = re.compile(_KEYWORD, re.MULTILINE)
_CLOSED = re.compile(r"\s*;")
_COMMENT = re.compile(r"//[^\n]*")
_BETWEEN = re.compile(r"[^\s;]")

_MESSAGE = {  # statement: regular expression up to the number of its message
    keyword: re.compile(rf"\s*{keyword}\s+(\d+)(?!\w)(?:\s+(\w+))?")
    for keyword in ("BO_", "VAL_", "SG_MUL_VAL_", "SIG_VALTYPE_", "BO_TX_BU_", "SIG_GROUP_")
} | {
    "BA_": re.compile(r'\s*BA_\s+"[^"]*"\s+(?:BO_|SG_)\s+(\d+)(?!\w)'),
    "CM_": re.compile(r"\s*CM_\s+(?:BO_|SG_)\s+(\d+)(?!\w)"),
}
_NAMED = re.compile(r'\s*\w+\s+(?:\w+\s+)?"([^"]*)"')
_SIGNAL_NAME = re.compile(r"\s*SG_\s+(\w+)")


class Statement(NamedTuple):
    """A statement of a DBC with its keyword; keyword "": text that is no statement."""

    keyword: str
    line: int  # where it begins
    text: str
    number: str  # of the message that it belongs to, as written; "": it belongs to none

    @property
    def attribute(self) -> str:
        """Name of the attribute that a BA_, BA_DEF_ or BA_DEF_DEF_ statement is about; "": none."""
        found = _NAMED.match(self.text)
        return found[1] if found else ""

    @property
    def name(self) -> str:
        """Name of the message or signal that a BO_ or SG_ defines, or that a VAL_ or SIG_VALTYPE_ is about."""
        found = _SIGNAL_NAME.match(self.text) if self.keyword == "SG_" else _MESSAGE[self.keyword].match(self.text)
        return (found[found.re.groups] or "") if found else ""

    def of_message(self, number: str) -> Statement:
        """Return a copy of the statement that belongs to the message with another number."""
        found = _MESSAGE[self.keyword].match(self.text) if self.keyword in _MESSAGE else None
        text = f"{self.text[: found.start(1)]}{number}{self.text[found.end(1) :]}" if found else self.text
        return self._replace(text=text, number=number)

    @property
    def place(self) -> str:
        """Line and keyword of the statement as text, for messages to the user."""
        return f"line {self.line}: {self.keyword or printable(shown(self.text))}"


def shown(text: str) -> str:
    """Return the beginning of a text in quotes, on one line, for messages to the user."""
    words = " ".join(text.split())
    return f"“{words[:30]}{'…' if len(words) > 30 else ''}”"


def statements_in(written: str) -> Iterator[Statement]:
    """Yield the statements of a DBC in order, and any text between them.

    A line that begins with a keyword begins a statement, unless it is within a text. A text that goes on beyond
    such a line and is not the end of its statement lacks its quotation mark.
    """
    line, counted, number = 1, 0, ""
    for keyword, begin, end in _spans(written):
        line += written.count("\n", counted, begin)
        counted = begin
        text = written[begin:end]
        if keyword not in ("", "SG_"):
            found = _MESSAGE[keyword].match(text) if keyword in _MESSAGE else None
            own = found[1] if found else ""
            number = own if keyword == "BO_" else ""  # an SG_ belongs to the BO_ before it
            yield Statement(keyword, line, text, own)
        else:
            yield Statement(keyword, line, text, number)


def _spans(written: str) -> Iterator[tuple[str, int, int]]:
    """Yield keyword, begin and end of each statement; text between statements has the keyword ""."""
    keyword, begin, at = "", 0, 0
    while found := _SCANNED.search(written, at):
        at = found.end()
        sign = found.group()
        if sign.startswith('"'):
            inner = _BEGINS.search(written, found.start(), at)
            if inner and not _CLOSED.match(written, at):
                at = inner.start()
        elif sign == ";" and keyword in _ENDED:
            yield keyword, begin, at
            keyword, begin = "", at
        elif sign != ";" and not sign.startswith("//"):
            yield from _span_of(written, keyword, begin, found.start())
            keyword, begin = sign.strip(), found.start()
    yield from _span_of(written, keyword, begin, len(written))


def _span_of(written: str, keyword: str, begin: int, end: int) -> Iterator[tuple[str, int, int]]:
    """Yield a span as a statement (keyword, begin, end); without a keyword only if it is more than comments."""
    if keyword:
        yield keyword, begin, end
        return
    plain = _COMMENT.sub(lambda found: " " * len(found.group()), written[begin:end])
    if between := _BETWEEN.search(plain):
        yield "", begin + between.start(), end


def text_of(statements: Sequence[Statement]) -> str:
    """Return the text of the DBC that consists of these statements."""
    return "\n".join(each.text.rstrip() for each in statements) + "\n"


class MessageStatements(NamedTuple):
    """The statements of a DBC about one message: BO_ and SG_ (`own`), and `others`."""

    number: str
    own: tuple[Statement, ...]
    others: tuple[Statement, ...]

    @property
    def all(self) -> tuple[Statement, ...]:
        """All statements about the message, BO_ first."""
        return self.own + self.others

    @property
    def name(self) -> str:
        """Name of the message; "": there is no BO_."""
        return self.own[0].name if self.own and self.own[0].keyword == "BO_" else ""

    def numbered(self, number: str) -> MessageStatements:
        """Return a copy of the statements that belongs to the message with another number."""
        own, others = (tuple(each.of_message(number) for each in some) for some in (self.own, self.others))
        return MessageStatements(number, own, others)

    @property
    def signals(self) -> set[str]:
        """Names of the message's signals."""
        return {each.name for each in self.own if each.keyword == "SG_"}


def by_message(statements: Sequence[Statement]) -> list[MessageStatements]:
    """Return the statements that belong to messages, grouped by message."""
    own: dict[str, list[Statement]] = {}
    others: dict[str, list[Statement]] = {}
    for each in statements:
        if each.number:
            (own if each.keyword in ("BO_", "SG_") else others).setdefault(each.number, []).append(each)
    return [
        MessageStatements(number, tuple(own.get(number, ())), tuple(others.get(number, ())))
        for number in {**own, **others}
    ]


# Statements without which a message means something else, and others that messages are made of.
_DEFINING = {"BO_", "SG_", "VAL_", "SIG_VALTYPE_", "SG_MUL_VAL_"}
_DESCRIBING = {"BO_TX_BU_", "CM_", "BA_"}
_NO_MATTER = {"NS_", "BS_", "VERSION"}
# Kinds that cantools' grammar lacks.
_UNKNOWN = {
    "BA_DEF_SGTYPE_", "BA_SGTYPE_", "CAT_DEF_", "CAT_", "EV_DATA_", "FILTER", "SGTYPE_VAL_", "SGTYPE_",
    "SIG_TYPE_REF_", "SIGTYPE_VALTYPE_",
}  # fmt: skip
# Attributes that say something about frames and signals, or name them.
_ATTRIBUTES = (
    "GenMsgCycleTime", "GenMsgSendType", "GenSigSendType", "GenSigStartValue", "VFrameFormat", "CANFD_BRS",
    "SystemMessageLongSymbol", "SystemSignalLongSymbol",
)  # fmt: skip
_MARK = 1 << 31  # in the number of a message whose identifier has 29 bits
_UNSIGNED = "VECTOR__INDEPENDENT_SIG_MSG"  # holds the signals that no message has
_HEAD = "BO_ 1 M: 8 Vector__XXX\n"
_SIGNAL = ' SG_ S : 0|8@1+ (1,0) [0|1] "" Vector__XXX\n'

_Attempt = Callable[[Sequence[MessageStatements]], list["Message"]]


def dbc_remains(written: str) -> Remains:
    """Return the readable messages (perhaps none) of a DBC with faulty statements, and what was left out."""
    remains = Remains()
    statements = list(_understood([*statements_in(written)], remains))
    definitions = [each for name in _ATTRIBUTES for each in _definition(name, statements, remains)]
    messages = list(_whole(statements, {each.attribute for each in definitions}, remains))

    def attempt(some: Sequence[MessageStatements]) -> list[Message]:
        return load_text(text_of([*definitions, *(each for one in some for each in one.all)]), ".dbc")

    if not messages:
        return remains
    try:
        remains.messages = attempt(messages)
    except Exception:  # cantools passes on exceptions of any kind from its parsers
        faulty = dict(refused(messages, attempt))
        sound = [_sound(each, attempt, remains) if each in faulty else each for each in messages]
        kept = [each for each in sound if each is not None]
        remains.messages = attempt(kept) if kept else ()
    return remains


def _understood(statements: Sequence[Statement], remains: Remains) -> Iterator[Statement]:
    """Yield the statements that matter and conform to the DBC grammar; note faulty ones in `remains`."""
    names = {each.number: each.name for each in statements if each.keyword == "BO_"}
    asked = [each for each in statements if each.keyword not in _NO_MATTER]
    faults = {each: why for each in asked if (why := _plain_fault(each))}
    for each, error in _refused_by_grammar([each for each in asked if each not in faults]):
        faults[each] = _not_understood(each, error)
    for each in asked:
        if each not in faults:
            yield each
        elif each.keyword in _DEFINING and (name := names.get(each.number)):
            remains.leave_out(name, f"{each.place} {faults[each]}")
        else:
            remains.notes.append(f"{each.place} {faults[each]}")


def _plain_fault(statement: Statement) -> str:
    """Return as text what is wrong with a statement, as far as visible without cantools; "": nothing."""
    if not statement.keyword:
        return "is no statement of a DBC"
    if statement.keyword in _UNKNOWN:
        return "is of a kind that is not read"
    if statement.keyword == "SG_" and not statement.number:
        return "belongs to no message"
    return f"is too large: {why}" if (why := too_large(statement.text, ".dbc")) else ""


def _refused_by_grammar(statements: Sequence[Statement]) -> Iterator[tuple[Statement, Exception]]:
    """Yield the statements that cantools' grammar refuses, each with the exception, which may state the place."""
    for first in range(0, len(statements), BLOCK):
        rest = statements[first : first + BLOCK]
        while (error := _grammar_error(rest)) is not None:
            ends = list(itertools.accumulate(len(_alone(each)) for each in rest))
            place = min(bisect.bisect_right(ends, getattr(error, "offset", 0)), len(rest) - 1)
            own = _grammar_error([rest[place]])
            if own is not None:
                yield rest[place], own
            else:
                yield from refused(rest[: place + 1], _parse)
            rest = rest[place + 1 :]


def _grammar_error(statements: Sequence[Statement]) -> Exception | None:
    """Return the exception of cantools' grammar for these statements; None if they conform to it."""
    try:
        load_text("".join(map(_alone, statements)), ".dbc")
    except Exception as error:
        return error if hasattr(error, "offset") else None  # others are about what the statements mean
    return None


def _parse(statements: Sequence[Statement]) -> None:
    """Parse these statements by cantools' grammar. Raises its exception if they do not conform to it."""
    if (error := _grammar_error(statements)) is not None:
        raise error


def _alone(statement: Statement) -> str:
    """Return a DBC text of this statement alone, which cantools' grammar accepts if the statement is complete."""
    return (_HEAD if statement.keyword == "SG_" else "") + text_of([statement]) + "BS_:\n"


def _not_understood(statement: Statement, error: Exception) -> str:
    """Return as text where the grammar refuses a statement, the end of a sentence."""
    rest = _alone(statement).removesuffix("BS_:\n")[getattr(error, "offset", 0) :]
    return f"is not understood from {shown(rest)} on" if rest.strip() else "lacks its end"


def _definition(name: str, statements: Sequence[Statement], remains: Remains) -> Sequence[Statement]:
    """Return the statements that define an attribute; none, and a note, if they contradict each other."""
    own = [each for each in statements if each.keyword in ("BA_DEF_", "BA_DEF_DEF_") and each.attribute == name]
    try:
        load_text(text_of(own) + _HEAD + _SIGNAL, ".dbc")
    except Exception:
        remains.notes += [f"{each.place} “{name}” contradicts the attribute's definition" for each in own]
        return ()
    return own


def _whole(statements: Sequence[Statement], defined: set[str], remains: Remains) -> Iterator[MessageStatements]:
    """Yield kept messages without statements on missing signals (noted) or attributes, 29-bit ones as extended."""
    for each in by_message(statements):
        if each.name in remains.left_out or each.name == _UNSIGNED:
            continue
        kept = []
        for other in each.others:
            if other.keyword in ("VAL_", "SIG_VALTYPE_") and other.name not in each.signals:
                lacking = f"is no signal of {each.name}" if each.name else f"has no message {each.number} here"
                remains.notes.append(f"{other.place} is about {other.name}, which {lacking}")
            elif other.keyword in _DEFINING or (
                other.keyword in _DESCRIBING and (other.keyword != "BA_" or other.attribute in defined)
            ):
                kept.append(other)
        if not each.name:
            continue
        message = each._replace(others=tuple(kept))
        if needs_29_bits(int(each.number)):
            remains.unmarked.append(each.name)
            message = message.numbered(str(int(each.number) | _MARK))
        yield message


def _sound(message: MessageStatements, attempt: _Attempt, remains: Remains) -> MessageStatements | None:
    """Return a faulty message without wrong descriptions; None: a wrong definition. `remains` notes either."""
    alone = message._replace(others=())
    try:
        attempt([alone])
    except Exception as error:
        remains.leave_out(message.name, f"{_place_of_fault(message, attempt)}: {reason_of(error)}")
        return None
    kept = list(message.others)
    for each, cause in refused(message.others, lambda some: attempt([message._replace(others=tuple(some))])):
        why = f"{each.place}: {reason_of(cause)}"
        if each.keyword in _DEFINING:
            remains.leave_out(message.name, why)
            return None
        remains.notes.append(why)
        kept.remove(each)
    return message._replace(others=tuple(kept))


def _place_of_fault(message: MessageStatements, attempt: _Attempt) -> str:
    """Return line and keyword of the refused statement of a message: its BO_, or its first refused SG_."""

    def together(signals: Sequence[Statement]) -> None:
        attempt([message._replace(own=(message.own[0], *signals), others=())])

    for signals in ([], *([each] for each in message.own[1:])):
        try:
            together(signals)
        except Exception:
            return (signals or message.own)[0].place
    return message.own[0].place

"""Reader of a DBC that cantools refuses: without faulty statements, and the messages that need them."""

from __future__ import annotations

import bisect
import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

from liftgate_hil.config.database_parts import (
    BLOCK,
    Remains,
    load_text,
    needs_29_bits,
    reason_of,
    refused,
    too_large,
)
from liftgate_hil.config.dbc_statements import (
    MessageStatements,
    Statement,
    by_message,
    shown,
    statements_in,
    text_of,
)

if TYPE_CHECKING:
    from cantools.database.can import Message

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
    """Return what is left of a DBC without its faults. Raises an exception if nothing can be read."""
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
    """Yield the statements that are as the grammar has them; others are noted."""
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
    """Return what is wrong with a statement that is seen without cantools; "": nothing."""
    if not statement.keyword:
        return "is no statement of a DBC"
    if statement.keyword in _UNKNOWN:
        return "is of a kind that is not read"
    if statement.keyword == "SG_" and not statement.number:
        return "belongs to no message"
    return f"is too large: {why}" if (why := too_large(statement.text, ".dbc")) else ""


def _refused_by_grammar(statements: Sequence[Statement]) -> Iterator[tuple[Statement, Exception]]:
    """Yield the statements that cantools' grammar refuses, and its exception.

    The exception says where it is, unless a text without its end has taken other statements with it.
    """
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
    """Return the exception of cantools' grammar, if it refuses these statements."""
    try:
        load_text("".join(map(_alone, statements)), ".dbc")
    except Exception as error:
        return error if hasattr(error, "offset") else None  # others are about what the statements mean
    return None


def _parse(statements: Sequence[Statement]) -> None:
    """Raise the exception of cantools' grammar, if it refuses these statements."""
    if (error := _grammar_error(statements)) is not None:
        raise error


def _alone(statement: Statement) -> str:
    """Return a text in which a statement may stand without those before it, and does not go on in the next one."""
    return (_HEAD if statement.keyword == "SG_" else "") + text_of([statement]) + "BS_:\n"


def _not_understood(statement: Statement, error: Exception) -> str:
    """Return where the grammar refuses a statement, as the end of a sentence."""
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
    """Yield the statements of each message that is not left out, without those that refer to nothing."""
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
    """Return a faulty message without the statements that describe it wrongly; None if it is left out."""
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
    """Return which of the statements that define a message is refused: its BO_, or the first such SG_."""

    def together(signals: Sequence[Statement]) -> None:
        attempt([message._replace(own=(message.own[0], *signals), others=())])

    for signals in ([], *([each] for each in message.own[1:])):
        try:
            together(signals)
        except Exception:
            return (signals or message.own)[0].place
    return message.own[0].place

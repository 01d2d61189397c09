"""The statements of a DBC, each with its line and the message that it belongs to."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from liftgate_hil.errors import printable

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
_SIGNAL = re.compile(r"\s*SG_\s+(\w+)")


class Statement(NamedTuple):
    """A statement of a DBC; without a keyword, text that is none."""

    keyword: str
    line: int  # where it begins
    text: str
    number: str  # of the message that it belongs to, as written; "": it belongs to none

    @property
    def attribute(self) -> str:
        """The attribute that a BA_, BA_DEF_ or BA_DEF_DEF_ is about."""
        found = _NAMED.match(self.text)
        return found[1] if found else ""

    @property
    def name(self) -> str:
        """The message or signal that a BO_ or SG_ defines, or that a VAL_ or SIG_VALTYPE_ is about."""
        found = _SIGNAL.match(self.text) if self.keyword == "SG_" else _MESSAGE[self.keyword].match(self.text)
        return (found[found.re.groups] or "") if found else ""

    def of_message(self, number: str) -> Statement:
        """Return the statement as that of the message of another number."""
        found = _MESSAGE[self.keyword].match(self.text) if self.keyword in _MESSAGE else None
        text = f"{self.text[: found.start(1)]}{number}{self.text[found.end(1) :]}" if found else self.text
        return self._replace(text=text, number=number)

    @property
    def place(self) -> str:
        """Line and keyword, for messages."""
        return f"line {self.line}: {self.keyword or printable(shown(self.text))}"


def shown(text: str) -> str:
    """Return the beginning of a text in quotes, on one line."""
    words = " ".join(text.split())
    return f"“{words[:30]}{'…' if len(words) > 30 else ''}”"


def statements_in(written: str) -> Iterator[Statement]:
    """Yield the statements of a DBC in their order, and what is written between them.

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
    """Yield keyword, begin and end of statements; without a keyword of the text between them."""
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
            yield from _before(written, keyword, begin, found.start())
            keyword, begin = sign.strip(), found.start()
    yield from _before(written, keyword, begin, len(written))


def _before(written: str, keyword: str, begin: int, end: int) -> Iterator[tuple[str, int, int]]:
    """Yield the statement that ends where another one begins; nothing where there are only comments."""
    if keyword:
        yield keyword, begin, end
        return
    plain = _COMMENT.sub(lambda found: " " * len(found.group()), written[begin:end])
    if between := _BETWEEN.search(plain):
        yield "", begin + between.start(), end


def text_of(statements: Sequence[Statement]) -> str:
    """Return the DBC that consists of these statements."""
    return "\n".join(each.text.rstrip() for each in statements) + "\n"


class MessageStatements(NamedTuple):
    """The statements about one message: its BO_ with its SG_, and others."""

    number: str
    own: tuple[Statement, ...]
    others: tuple[Statement, ...]

    @property
    def all(self) -> tuple[Statement, ...]:
        """All statements, BO_ first."""
        return self.own + self.others

    @property
    def name(self) -> str:
        """Name of the message; "": there is no BO_."""
        return self.own[0].name if self.own and self.own[0].keyword == "BO_" else ""

    def numbered(self, number: str) -> MessageStatements:
        """Return the statements as those of the message of another number."""
        own, others = (tuple(each.of_message(number) for each in some) for some in (self.own, self.others))
        return MessageStatements(number, own, others)

    @property
    def signals(self) -> set[str]:
        """Names of its signals."""
        return {each.name for each in self.own if each.keyword == "SG_"}


def by_message(statements: Sequence[Statement]) -> list[MessageStatements]:
    """Return the statements that belong to messages, by message."""
    own: dict[str, list[Statement]] = {}
    others: dict[str, list[Statement]] = {}
    for each in statements:
        if each.number:
            (own if each.keyword in ("BO_", "SG_") else others).setdefault(each.number, []).append(each)
    return [
        MessageStatements(number, tuple(own.get(number, ())), tuple(others.get(number, ())))
        for number in {**own, **others}
    ]

"""Reader of a KCD or a SYM that cantools refuses: without the faulty messages."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING
from xml.etree import ElementTree

from liftgate_hil.config.database_parts import (
    Part,
    Remains,
    load_text,
    needs_29_bits,
    reason_of,
    refused,
    too_large,
)
from liftgate_hil.errors import ConfigError

if TYPE_CHECKING:
    from cantools.database.can import Message

_Element = ElementTree.Element
_SECTION = re.compile(r"^\{(\w+)\}", re.MULTILINE)
_SYMBOL = re.compile(r"^\[(.*)\]", re.MULTILINE)
_SYMBOLS = {"SEND", "RECEIVE", "SENDRECEIVE"}  # sections of a SYM with messages
_IDENTIFIER = re.compile(r"^([ \t]*ID=)([0-9A-Fa-f]+)(?=h)", re.MULTILINE)
_DIGITS = 8  # of an identifier of 29 bits in a SYM
_VERSION_5 = re.compile(r"^FormatVersion=5\.0\b", re.MULTILINE)
# Keywords of a SYM 5.0 that have other names in 6.0: values of a type, and the length of a message.
_OF_VERSION_5 = (
    (re.compile(r"^[ \t]*enum[ \t]+(?=[^\n=]*\()", re.MULTILINE), "Enum="),
    (re.compile(r"^[ \t]*DLC[ \t]*=", re.MULTILINE), "Len="),
)


def kcd_remains(written: str) -> Remains:
    """Return what is left of a KCD without its faulty messages. Raises an exception if nothing can be read."""
    root = ElementTree.fromstring(written)
    buses = [each for each in root.iter() if each.tag.endswith("}Bus")]
    messages = [(bus, each) for bus in buses for each in bus if each.tag.endswith("}Message")]
    remains = Remains()
    for bus, message in messages:
        bus.remove(message)
        with contextlib.suppress(ValueError):
            if message.get("format") != "extended" and needs_29_bits(int(message.get("id", ""), 0)):
                message.set("format", "extended")
                remains.unmarked.append(message.get("name", ""))

    def text_with(some: Sequence[tuple[_Element, _Element]]) -> str:
        for bus, message in some:
            bus.append(message)
        text = ElementTree.tostring(root, encoding="unicode")
        for bus, message in some:
            bus.remove(message)
        return text

    def fault_of(part: tuple[_Element, _Element]) -> str:
        return too_large(ElementTree.tostring(part[1], encoding="unicode"), ".kcd")

    return _fill(
        remains,
        messages,
        fault_of,
        lambda some: load_text(text_with(some), ".kcd"),
        lambda part: part[1].get("name", ""),
    )


def as_sym_6(written: str) -> str:
    """Return a SYM of version 5.0 as one of 6.0, which has the same lines; any other as it is."""
    text, is_5 = _VERSION_5.subn("FormatVersion=6.0", written, count=1)
    for old, new in _OF_VERSION_5 if is_5 else ():
        text = old.sub(new, text)
    return text


def sym_remains(written: str) -> Remains:
    """Return what is left of a SYM without its faulty messages. Raises an exception if nothing can be read.

    Sections with the same name in brackets are the multiplexed parts of one message.
    """
    head, symbols = "", dict[tuple[str, str], str]()
    begins = [found.start() for found in _SECTION.finditer(written)]
    for begin, end in zip([0, *begins], [*begins, len(written)], strict=True):
        text = written[begin:end]
        section = _SECTION.match(text)
        if section is None or section[1] not in _SYMBOLS:
            head += text
            continue
        places = [found.start() for found in _SYMBOL.finditer(text)]
        for first, last in zip(places, [*places[1:], len(text)], strict=True):
            key = section[1], text[first + 1 : text.index("]", first)]
            symbols[key] = symbols.get(key, "") + text[first:last]
    remains = Remains()
    for key, text in symbols.items():
        found = _IDENTIFIER.search(text)
        if found and len(found[2]) < _DIGITS and needs_29_bits(int(found[2], 16)):
            symbols[key] = f"{text[: found.start(2)]}{found[2]:0>{_DIGITS}}{text[found.end(2) :]}"
            remains.unmarked.append(_name_of(key))

    def text_with(some: Sequence[tuple[str, str]]) -> str:
        return head + "".join(f"\n{{{section}}}\n{symbols[section, name]}\n" for section, name in some)

    if wrong := too_large(head, ".sym"):
        raise ConfigError(wrong)
    return _fill(
        remains,
        list(symbols),
        lambda part: too_large(symbols[part], ".sym"),
        lambda some: load_text(text_with(some), ".sym"),
        _name_of,
    )


def _name_of(symbol: tuple[str, str]) -> str:
    return symbol[1].strip('"')


def _fill(
    remains: Remains,
    parts: Sequence[Part],
    fault_of: Callable[[Part], str],
    attempt: Callable[[Sequence[Part]], list[Message]],
    name_of: Callable[[Part], str],
) -> Remains:
    """Add the messages of the parts that are sound, and the names of the others with the reasons."""
    faults = {part: f"it is too large: {why}" for part in parts if (why := fault_of(part))}
    faults |= {
        part: reason_of(error) for part, error in refused([each for each in parts if each not in faults], attempt)
    }
    for part, why in faults.items():
        remains.leave_out(name_of(part), why)
    remains.messages = attempt([each for each in parts if each not in faults])
    return remains

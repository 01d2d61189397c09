"""Parser of conditions by recursive descent, with a check of units."""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from liftgate_hil.codec.watch import near_signals, signal_unit
from liftgate_hil.conditions import condition as codes
from liftgate_hil.conditions.condition import Condition, unit_of_column
from liftgate_hil.signals import COLUMNS, SENSED_PREFIX

if TYPE_CHECKING:
    from cantools.database.can import Message

    from liftgate_hil.codec.messages import Messages

_LONGEST = 4000  # characters
_KEPT = 4096  # parsed conditions that are cached
_BUS_SIGNAL = re.compile(r"[^\W\d]\w*\.[^\W\d]\w*")
_PARAMETER = re.compile(r"\$(\w+)")
_COMPARISONS = {"<": codes.LT, "<=": codes.LE, ">": codes.GT, ">=": codes.GE, "==": codes.EQ, "!=": codes.NE}
# Signs of other languages, and ours.
_OF_OTHERS = {"=>": ">=", "=<": "<=", "=": "==", "&": "and", "|": "or", "!": "not"}
_SUMS, _PRODUCTS = {"+": codes.ADD, "-": codes.SUB}, {"*": codes.MUL, "/": codes.DIV}
_TOKEN = re.compile(
    r"""\s*(?:
      (?P<number>(?:\d[\d_]*\.?[\d_]*|\.\d[\d_]*)(?:[eE][+-]?\d+)?)
    | (?P<parameter>\$\w+)
    | (?P<name>[^\W\d]\w*(?:\.[^\W\d]\w*)?)
    | (?P<sign><=|>=|==|!=|[<>+\-*/()])
    )""",
    re.VERBOSE,
)


def parsed(text: str, parameters: Mapping[str, float], messages: Messages | None = None) -> Condition:
    """Parse and validate the text of a condition; each `$name` in it gets its value in `parameters`.

    `messages` are the rig's database's; None: not known yet, so that the condition may refer to any signal.

    Raises ValueError, which says what is wrong and what is allowed.
    """
    names = dict.fromkeys(_BUS_SIGNAL.findall(text))
    units = [(name, "" if messages is None else signal_unit(messages, name)) for name in names]
    used = _PARAMETER.findall(text)
    given = (
        parameters if any(name not in parameters for name in used) else {name: parameters[name] for name in used}
    )
    try:
        return _parsed(text, tuple(given.items()), tuple(units))
    except _NoSuchSignalError as error:
        if messages is not None and (why_not := messages.why_not(str(error).partition(".")[0])):
            raise ValueError(f"{error}: {why_not}") from None
        near = near_signals(messages or {}, str(error))
        raise ValueError(
            f"{error}: no such signal in the rig's database; allowed: "
            f"{', '.join(near) + ', …' if near else 'Message.Signal of it'}"
        ) from None
    except _NoSuchColumnError as error:
        name = str(error)
        numbers = _numbers_of(name, text, messages or {})
        if not numbers and messages is None and any(not each.startswith("sensed.") for each in names):
            numbers = "columns of recordings, and numbers in place of a signal's labels"
        allowed = f"${name}, the parameter" if name in parameters else numbers or _near_columns(name)
        raise ValueError(f"{name}: no such column; allowed: {allowed}") from None


def with_numbers(text: str, parameters: Mapping[str, float]) -> str:
    """Return a condition's text with its known parameters replaced by numbers."""

    def number(found: re.Match[str]) -> str:
        return f"{parameters[found[1]]:.10g}" if found[1] in parameters else found[0]

    return _PARAMETER.sub(number, text)


@functools.lru_cache(_KEPT)
def _parsed(
    text: str, parameters: tuple[tuple[str, float], ...], units: tuple[tuple[str, str | None], ...]
) -> Condition:
    """Return the condition of a text, cached; `units` are those of the signals that the text names."""
    return _Parser(text, dict(parameters), dict(units).get).condition()


class _NoSuchSignalError(ValueError):
    """Raised for a signal that the database does not have; the exception's text is its name."""


class _NoSuchColumnError(ValueError):
    """Raised for a name that is no column; the exception's text is the name."""


class _Part(NamedTuple):
    """A parsed operand of an operation: whether it is a truth value, and its unit (None: a plain number)."""

    is_truth: bool
    unit: str | None = None


@dataclass
class _Parser:
    """Recursive-descent parser with a method per precedence level; operations follow their operands."""

    text: str
    parameters: Mapping[str, float]
    signal_unit: Callable[[str], str | None]
    tokens: list[tuple[str, str, int]] = field(default_factory=list)  # kind, text, position
    next: int = 0
    ops: list[tuple[int, str | float]] = field(default_factory=list)
    units: list[str] = field(default_factory=list)
    depth: int = 0
    stack: int = 0

    def condition(self) -> Condition:
        """Return the condition of the whole text. Raises ValueError as `parsed` does."""
        if len(self.text) > _LONGEST:
            raise ValueError(f"{len(self.text)} characters; allowed: up to {_LONGEST}")
        self._tokenize()
        part = self._either()
        kind = self._here()[0]
        if kind != "end":
            is_number = self.tokens[self.next - 1][0] == "number"
            is_unit = is_number and kind == "name" and self._here()[1].lower() not in ("and", "or", "not")
            self._wrong(f"and, or, or the end{'; units are not written, as columns have them' if is_unit else ''}")
        if not part.is_truth:
            raise ValueError(f"{self.text!r} is not a comparison; allowed: a comparison, e.g. gate_angle_deg > 20")
        return Condition(self.text, tuple(self.ops), tuple(self.units))

    def _tokenize(self) -> None:
        """Split the text into `tokens`. Raises ValueError."""
        place, text = 0, self.text
        while text[place:].strip():
            found = _TOKEN.match(text, place)
            if found is None or found.lastgroup is None:
                place += len(text[place:]) - len(text[place:].lstrip())
                theirs = next((sign for sign in _OF_OTHERS if text.startswith(sign, place)), "")
                if theirs:
                    raise ValueError(f"{theirs!r} at character {place + 1}; allowed: {_OF_OTHERS[theirs]}")
                raise ValueError(
                    f"{text[place]!r} at character {place + 1}; allowed: columns, Message.Signal, numbers, $name, "
                    "< <= > >= == != + - * / abs() and or not ( )"
                )
            kind = found.lastgroup
            token, begin = found.group(kind), found.start(kind) + 1
            if kind == "name" and token in ("and", "or", "not", "abs"):
                kind = "sign"
            self.tokens.append((kind, token, begin))
            place = found.end()
        self.tokens.append(("end", "the condition ends", len(text) + 1))

    def _here(self) -> tuple[str, str, int]:
        """Return the next token, which is not consumed: its kind, its text and its position."""
        return self.tokens[self.next]

    def _is(self, token: str) -> bool:
        """Consume the token `token` if it comes next; return whether it did."""
        if self._here()[:2] != ("sign", token):
            return False
        self.next += 1
        return True

    def _wrong(self, allowed: str) -> None:
        """Raise ValueError about the next token; `allowed` says what may stand there."""
        kind, token, place = self._here()
        where = "" if kind == "end" else f" at character {place}"
        raise ValueError(f"{token}{where}; allowed: {allowed}")

    def _append(self, code: int, what: str | float = 0.0) -> None:
        """Append an operation; raise ValueError if the evaluator's stack is too small for it."""
        self.ops.append((code, what))
        if code <= codes.SIGNAL:
            self.stack += 1
        elif code not in (codes.NEG, codes.ABS, codes.NOT):
            self.stack -= 1
        if self.stack > codes.DEEPEST:
            raise ValueError(f"values nested deeper than {codes.DEEPEST}; allowed: a simpler condition")

    def _either(self) -> _Part:
        return self._joined(self._both, "or", codes.OR)

    def _both(self) -> _Part:
        return self._joined(self._negated, "and", codes.AND)

    def _joined(self, part: Callable[[], _Part], word: str, code: int) -> _Part:
        """Parse operands, each read by `part()`, with `word` (and, or) between them; `code` is its operation."""
        place = self._here()[2]
        left = part()
        while self._is(word):
            self._check_truth(left, place, word)
            place = self._here()[2]
            self._check_truth(part(), place, word)
            self._append(code)
        return left

    def _check_truth(self, part: _Part, place: int, word: str) -> None:
        """Raise ValueError if `part`, an operand of `word`, is a number."""
        if not part.is_truth:
            raise ValueError(
                f"at character {place}: a number beside `{word}`; allowed: a comparison, e.g. gate_angle_deg > 20"
            )

    def _negated(self) -> _Part:
        count = 0
        while self._is("not"):
            count += 1
        place = self._here()[2]
        part = self._comparison()
        if count:
            self._check_truth(part, place, "not")
        for _ in range(count % 2):
            self._append(codes.NOT)
        return part

    def _comparison(self) -> _Part:
        place = self._here()[2]
        left = self._sum()
        kind, token, at = self._here()
        if kind != "sign" or token not in _COMPARISONS:
            return left
        self.next += 1
        right_place = self._here()[2]
        number = len(self.units)
        self.units.append("")
        right = self._sum()
        self._check_number(left, place)
        self._check_number(right, right_place)
        self._append(_COMPARISONS[token])
        self.units[number] = self._same_unit(left.unit, right.unit, token, at) or ""
        if self._here()[1] in _COMPARISONS:
            self._wrong("one comparison at a time, joined by and")
        return _Part(True)

    def _check_number(self, part: _Part, place: int) -> None:
        """Raise ValueError if `part`, which must be a number, is a truth value."""
        if part.is_truth:
            raise ValueError(f"at character {place}: a comparison where a number is expected")

    def _same_unit(self, a: str | None, b: str | None, token: str, place: int) -> str | None:
        """Return the common unit; numbers and values without one fit any. Raises ValueError if units differ."""
        if a and b and a != b:
            raise ValueError(
                f"{token} at character {place} combines {a} and {b}; allowed: the same unit on both sides"
            )
        return a or b or (a if a is not None else b)

    def _sum(self) -> _Part:
        return self._arithmetic(self._product, _SUMS)

    def _product(self) -> _Part:
        return self._arithmetic(self._signed, _PRODUCTS)

    def _arithmetic(self, part: Callable[[], _Part], signs: Mapping[str, int]) -> _Part:
        """Parse operands, each read by `part()`, with `signs` between them: operation codes by sign."""
        place = self._here()[2]
        left = part()
        while self._here()[0] == "sign" and self._here()[1] in signs:
            _, token, at = self._here()
            self.next += 1
            self._check_number(left, place)
            right_place = self._here()[2]
            right = part()
            self._check_number(right, right_place)
            self._append(signs[token])
            if token in _SUMS:
                unit = self._same_unit(left.unit, right.unit, token, at)
            else:
                unit = _product_unit(left.unit, right.unit, token)
            left = _Part(False, unit)
        return left

    def _signed(self) -> _Part:
        place, negative = self._here()[2], False
        while (minus := self._is("-")) or self._is("+"):
            negative ^= minus
        part = self._primary()
        if negative:
            self._check_number(part, place)
            self._append(codes.NEG)
        return part

    def _primary(self) -> _Part:
        kind, token, _ = self._here()
        if kind == "name" and self.tokens[self.next + 1][1] == "(":
            raise ValueError(f"{token}(): no such function; allowed: abs()")
        if kind in ("number", "parameter", "name"):
            self.next += 1
            return getattr(self, f"_{kind}_named")(token)  # type: ignore[no-any-return]
        if token == "abs" and self.tokens[self.next + 1][1] == "(":
            self.next += 1
            place = self._here()[2]
            part = self._parenthesised()
            self._check_number(part, place)
            self._append(codes.ABS)
            return part
        if token == "(":
            return self._parenthesised()
        self._wrong("a column, Message.Signal, a number, $name, abs(), not, or (")
        raise AssertionError

    def _parenthesised(self) -> _Part:
        self.depth += 1
        if self.depth > codes.DEEPEST:
            raise ValueError(f"parentheses deeper than {codes.DEEPEST}; allowed: up to {codes.DEEPEST}")
        self._is("(")
        part = self._either()
        if not self._is(")"):
            self._wrong(")")
        self.depth -= 1
        return part

    def _number_named(self, token: str) -> _Part:
        try:
            value = float(token)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise ValueError(f"{token}; allowed: a finite number")
        self._append(codes.CONST, value)
        return _Part(False)

    def _parameter_named(self, token: str) -> _Part:
        if token[1:] not in self.parameters:
            known = ", ".join(f"${name}" for name in self.parameters)
            raise ValueError(f"{token}: no such parameter; allowed: {known or 'none, there are no [parameters]'}")
        self._append(codes.CONST, float(self.parameters[token[1:]]))
        return _Part(False)

    def _name_named(self, token: str) -> _Part:
        """Append a column or a bus signal. Raises _NoSuchColumnError or _NoSuchSignalError."""
        column = token.replace("sensed.", SENSED_PREFIX, 1) if token.startswith("sensed.") else token
        unit = unit_of_column(column)
        if unit is not None and ("." in token or not token.startswith(SENSED_PREFIX)):
            self._append(codes.COLUMN, column)
            return _Part(False, unit)
        if "." in token and not token.startswith("sensed."):
            unit = self.signal_unit(token)
            if unit is not None:
                self._append(codes.SIGNAL, token)
                return _Part(False, unit)
            raise _NoSuchSignalError(token)
        raise _NoSuchColumnError(token)


def _product_unit(a: str | None, b: str | None, token: str) -> str | None:
    """Return the unit of a product (`token` *) or quotient of values with units a and b; None: a plain number."""
    if token == "*":
        return f"{a} {b}" if a and b else a or b or (a if a is not None else b)
    if not b:
        return a if a is not None else b
    return "" if a == b else f"{a or '1'}/{b}"


def _numbers_of(label: str, text: str, messages: Mapping[str, Message]) -> str:
    """Return as text the numbers of a label in the value tables of a condition's signals; "": it is no label."""
    found = [
        f"{number}, which is {label} of {name}"
        for name in dict.fromkeys(re.findall(r"[^\W\d]\w*", text))
        if name in COLUMNS
        for number, value in enumerate(COLUMNS[name].values)
        if value == label
    ]
    for name in dict.fromkeys(_BUS_SIGNAL.findall(text)):
        message, _, signal = name.partition(".")
        signals = messages[message].signals if message in messages else []
        found += [
            f"{number}, which is {label} of {name}"
            for each in signals
            if each.name == signal
            for number, value in (each.choices or {}).items()
            if str(value) == label
        ]
    return "; ".join(found)


def _near_columns(token: str) -> str:
    """Return as text the columns whose names are most similar to an unknown one."""
    from difflib import get_close_matches

    names = [
        name if not name.startswith(SENSED_PREFIX) else f"sensed.{name.removeprefix(SENSED_PREFIX)}"
        for name in COLUMNS
    ]
    near = get_close_matches(token, names, 3, 0.5)
    return f"{', '.join(near)}, …" if near else "columns of recordings, such as gate_angle_deg"

"""Find the signals of a database that may carry a quantity, by name, unit, side (left, right) and sender."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from liftgate_hil.config.drafting.words import concepts_in, is_message_counter, side_of, words_of
from liftgate_hil.config.units import dimensions_named
from liftgate_hil.signals import BUS_INPUTS, BUS_OUTPUTS, PANEL, TRUE_PREFIX, Rod

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal


class QuantityWords(NamedTuple):
    """Words by which a signal of a quantity is recognized; a quantity with "{side}" is one of each drive."""

    section: str  # section of a rig, or `panel`: those inputs that a test bench sets
    quantity: str  # with "{side}" in it, e.g. "{side}_current", one of a drive
    needs: tuple[frozenset[str], ...]  # sets of concepts, of which a name must contain all of one set
    avoids: frozenset[str] = frozenset()
    dimensions: tuple[str, ...] = ()  # dimensions that its unit may have; (): any
    is_flag: bool = False  # one bit


def _needs(*spelled: str) -> tuple[frozenset[str], ...]:
    """Return each text as a set of concepts; in a text they are separated by "+"."""
    return tuple(frozenset(each.split("+")) for each in spelled)


_SENSORS = frozenset({"current", "voltage", "temperature", "hall", "angle"})
NOBODY = {"XXX", "Vector__XXX"}  # what databases name an unknown sender
_NO_LIMIT = frozenset({"limit"})
_NO_DRIVE = _NO_LIMIT | {"motor", "left", "right"}
KINDS = (
    QuantityWords("inputs", "{side}_duty", _needs("duty"), _NO_LIMIT | {"actual"}, ("share",)),
    QuantityWords("inputs", "{side}_direction", _needs("direction"), _SENSORS | _NO_LIMIT | {"actual"}),
    QuantityWords("inputs", "latch_release", _needs("latch"), _SENSORS | {"actual"}),
    QuantityWords("outputs", "{side}_current", _needs("current"), _NO_LIMIT | {"duty"}, ("current",)),
    QuantityWords("outputs", "{side}_hall_count", _needs("hall+count"), _NO_LIMIT | {"speed"}, ("number",)),
    QuantityWords("outputs", "{side}_hall_speed", _needs("hall+speed"), _NO_LIMIT, ("number",)),
    QuantityWords("outputs", "{side}_hall_a", _needs("hall+channel a"), _NO_LIMIT | {"count"}, is_flag=True),
    QuantityWords("outputs", "{side}_hall_b", _needs("hall+channel b"), _NO_LIMIT | {"count"}, is_flag=True),
    QuantityWords("outputs", "{side}_period_speed", _needs("period+speed"), _NO_LIMIT, ("rate of turning",)),
    QuantityWords("outputs", "{side}_edge_age", _needs("edge+age"), _NO_LIMIT, ("time",)),
    QuantityWords("outputs", "true_{side}_speed", _needs("motor+speed", "hall+speed", "left+speed", "right+speed"),
         _NO_LIMIT | {"period"}, ("rate of turning",)),
    QuantityWords("outputs", "true_{side}_position", _needs("motor+position", "left+position", "right+position"),
         _NO_LIMIT | {"hall"}, ("angle",)),
    QuantityWords("outputs", "gate_angle", _needs("angle", "position+gate"), _NO_DRIVE | {"slope", "speed"},
         ("angle",)),
    QuantityWords("outputs", "true_gate_rate", _needs("angle+speed", "speed+gate"), _NO_DRIVE | {"hall"},
         ("rate of turning",)),
    QuantityWords("outputs", "latch_state", _needs("latch"), _SENSORS | {"release"}),
    QuantityWords("outputs", "terminal_voltage", _needs("voltage"), _NO_LIMIT | {"motor"}, ("voltage",)),
    QuantityWords("outputs", "true_{side}_voltage", _needs("motor+voltage"), _NO_LIMIT, ("voltage",)),
    QuantityWords("outputs", "ambient_temperature", _needs("ambient+temperature"), _NO_LIMIT, ("temperature",)),
    QuantityWords("outputs", "{side}_motor_temperature", _needs("motor+temperature"), _NO_LIMIT | {"ambient"},
         ("temperature",)),
    QuantityWords("outputs", "road_slope", _needs("slope"), _NO_LIMIT, ("angle",)),
    QuantityWords("outputs", "gate_acceleration", _needs("acceleration+gate"), _NO_LIMIT, ("acceleration",)),
    QuantityWords("outputs", "{side}_pinch_strip", _needs("pinch strip"), _NO_LIMIT, is_flag=True),
    QuantityWords("outputs", "handle_pulled", _needs("handle"), _NO_LIMIT, is_flag=True),
    QuantityWords("outputs", "button_pressed", _needs("button"), _NO_LIMIT, is_flag=True),
    QuantityWords("outputs", "true_hand_force", _needs("hand force"), _NO_LIMIT, ("force",)),
    QuantityWords("panel", "road_slope", _needs("slope"), _NO_LIMIT, ("angle",)),
    QuantityWords("panel", "hand_force", _needs("hand force"), _NO_LIMIT, ("force",)),
    QuantityWords("panel", "supply_voltage", _needs("voltage"), _NO_LIMIT | {"motor"}, ("voltage",)),
    QuantityWords("panel", "ambient_temperature", _needs("ambient+temperature"), _NO_LIMIT, ("temperature",)),
    QuantityWords("panel", "handle_pulled", _needs("handle"), _NO_LIMIT, is_flag=True),
    QuantityWords("panel", "button_pressed", _needs("button"), _NO_LIMIT, is_flag=True),
)  # fmt: skip


@dataclass(frozen=True)
class SignalCandidate:
    """A signal of the database that may carry a quantity."""

    quantity: str
    message: Message
    signal: Signal
    fits: bool  # its unit, if known, is one of the quantity's
    is_named: bool  # its name is exactly that of the quantity
    sender: str = ""  # the sender if it is neither the ECU nor the gate

    @property
    def name(self) -> str:
        """Name of the signal as MESSAGE.SIGNAL."""
        return f"{self.message.name}.{self.signal.name}"

    @property
    def unit(self) -> str:
        """Unit of the signal in the database."""
        return (self.signal.unit or "").strip()


Found = dict[str, dict[str, list[SignalCandidate]]]  # section: quantity: candidates


class Search(NamedTuple):
    """Result of the search: the best candidates for each quantity, and the others, which were not chosen."""

    found: Found  # several candidates for a quantity if nothing tells them apart
    not_chosen: Mapping[str, tuple[str, str]]  # MESSAGE.SIGNAL: quantity that it may be, and why it was not chosen


def find_candidates(messages: Mapping[str, Message]) -> Search:
    """Return the best candidates for each quantity, and the other candidates, which were not chosen."""
    found: Found = {"inputs": {}, "outputs": {}}
    speaks_of_gate = any(map(_speaks_of_gate, messages.values()))
    for message, section, sender in _roles(messages):
        panel = _panel(message) if sender else {}
        for quantity, candidate in panel.items():
            found["inputs"].setdefault(quantity, []).append(candidate)
        for signal in [] if panel else message.signals:
            if is_protection(message, signal):
                continue
            several = list(_of(message, signal, section))
            # A signal whose unit fits no quantity is still reported; one that fits some is no candidate elsewhere.
            fitting = [each for each in several if each.fits] or several
            for candidate in fitting:
                each = replace(candidate, sender=sender)
                found["outputs" if section == "outputs" else "inputs"].setdefault(each.quantity, []).append(each)
    best = {
        section: {quantity: _best(candidates, speaks_of_gate) for quantity, candidates in each.items()}
        for section, each in found.items()
    }
    return Search(best, _not_chosen(found, best))


def _not_chosen(found: Found, best: Found) -> dict[str, tuple[str, str]]:
    """Return the candidates that are not the best ones of any quantity, as in `Search.not_chosen`."""
    chosen = {each.name for section in best.values() for several in section.values() for each in several}
    return {
        each.name: (quantity, _why_rather(each, best[section][quantity][0]))
        for section, quantities in found.items()
        for quantity, several in quantities.items()
        for each in several
        if each.name not in chosen
    }


def _why_rather(one: SignalCandidate, chosen: SignalCandidate) -> str:
    """Return as text why the chosen candidate was preferred to another one, see `_best`."""
    if chosen.fits and not one.fits:
        return f"{chosen.name} has a fitting unit"
    return (
        f"{chosen.name} has its name" if chosen.is_named and not one.is_named else f"{chosen.name} names the gate"
    )


def _panel(message: Message) -> dict[str, SignalCandidate]:
    """Return a candidate per quantity that a test panel's message sets; {}: no quantity of the obstacle is set."""
    names = {"".join(words_of(signal.name)): signal for signal in message.signals}
    found = {
        quantity: SignalCandidate(quantity, message, names[_joined(quantity)], True, True)
        for quantity in PANEL
        if _joined(quantity) in names
    }
    return found if {*found} & {*Rod._fields} else {}


def _roles(messages: Mapping[str, Message]) -> Iterator[tuple[Message, str, str]]:
    """Yield each relevant message, the rig's section for it, and its sender if that is neither ECU nor gate.

    The ECU's commands to the motors are inputs; what the gate receives from another node is `panel`, as it cannot
    send it; messages of all other senders may be outputs.
    """
    commands, sensors = _commands(messages), _sensors(messages)
    nodes = {sender for message in messages.values() for sender in message.senders} - NOBODY
    ecus = _senders(messages, commands) & nodes if len(nodes) > 1 else set()
    gates = _senders(messages, sensors) - ecus
    for message in messages.values():
        senders = {*message.senders} & nodes
        if message.name in commands:
            yield message, "inputs", ""
        elif not senders & ecus:
            is_known = not senders or not gates or bool(senders & gates)
            section = "panel" if not is_known and gates & {*message.receivers} else "outputs"
            yield message, section, "" if is_known else ", ".join(sorted(senders))


def _senders(messages: Mapping[str, Message], names: Iterable[str]) -> set[str]:
    return {sender for name in names for sender in messages[name].senders}


def _sensors(messages: Mapping[str, Message]) -> list[str]:
    """Return the names of the messages with sensor readings of the drives; if some name a gate, only those."""
    found = [name for name, message in messages.items() if any(map(_is_of_a_drive, _all_of(message, "outputs")))]
    return [name for name in found if _speaks_of_gate(messages[name])] or found


def _is_of_a_drive(candidate: SignalCandidate) -> bool:
    """Whether a candidate is a sensor reading of a drive: current, Hall count or Hall speed."""
    return candidate.quantity.endswith(("_current", "_hall_count", "_hall_speed"))


def _speaks_of_gate(message: Message) -> bool:
    """Whether the name of a message, or of one of its signals, has a word for the gate."""
    names = (message.name, *(signal.name for signal in message.signals))
    return any("gate" in concepts_in(name) for name in names)


def _all_of(message: Message, section: str) -> Iterator[SignalCandidate]:
    """Yield the candidates, by `_of`, of all signals of a message."""
    for signal in message.signals:
        yield from _of(message, signal, section)


def _commands(messages: Mapping[str, Message]) -> list[str]:
    """Return the names of the ECU's messages that command the motors; if some name a gate, only those."""
    found = [
        name
        for name, message in messages.items()
        if any(candidate.quantity.endswith(("_duty", "_direction")) for candidate in _all_of(message, "inputs"))
        and not any(map(_is_of_a_drive, _all_of(message, "outputs")))
    ]
    return [name for name in found if _speaks_of_gate(messages[name])] or found


def is_protection(message: Message, signal: Signal) -> str:
    """Return "counter" or "checksum" if a signal is one by its name and length; else ""."""
    # Words of the message's own name say nothing about the signal.
    own = [word for word in words_of(signal.name) if word not in words_of(message.name)]
    concepts = concepts_in("_".join(own))
    if signal.is_float or signal.is_signed or signal.multiplexer_signal is not None:
        return ""
    if "checksum" in concepts and signal.length in (8, 16):
        return "checksum"
    if is_message_counter(concepts) and 2 <= signal.length <= 8:
        return "counter"
    return ""


def _of(message: Message, signal: Signal, section: str) -> Iterator[SignalCandidate]:
    """Yield a candidate for each quantity that a signal may carry."""
    quantities = {"inputs": BUS_INPUTS, "outputs": BUS_OUTPUTS, "panel": PANEL}[section]
    own = concepts_in(signal.name)
    # The message's name counts where the signal's own name leaves it open.
    all_said = own | (concepts_in(message.name) & {"gate", "motor", "hall", "latch", "left", "right"})
    side = side_of(signal.name, message.name)
    plain = "".join(words_of(signal.name))
    is_found = False
    for kind in KINDS:
        if kind.section != section:
            continue
        quantity = kind.quantity.format(side=side or "either")
        own_name = kind.quantity.removeprefix(TRUE_PREFIX).removeprefix("{side}_")
        is_named = plain in (_joined(quantity), _joined(_plain(quantity)), _joined(own_name))
        if not is_named and not _fits(kind, own, all_said, signal):
            continue
        is_found = is_found or _is_of(kind, signal)
        yield SignalCandidate(quantity, message, signal, _is_of(kind, signal), is_named)
    # Other quantities of the catalogue match by their exact names only.
    for quantity in quantities:
        if plain in (_joined(quantity), _joined(_plain(quantity))) and not is_found:
            yield SignalCandidate(quantity, message, signal, True, True)


def _plain(quantity: str) -> str:
    """Return a quantity's name as databases use it: without "true_", unless a sensor measures it, too."""
    plain = quantity.removeprefix(TRUE_PREFIX)
    return quantity if plain in BUS_OUTPUTS else plain


def _joined(quantity: str) -> str:
    return quantity.replace("_", "")


def _fits(kind: QuantityWords, own: frozenset[str], concepts: frozenset[str], signal: Signal) -> bool:
    """Whether a signal's name and length are possible for a kind of quantity."""
    if own & kind.avoids or not any(need <= concepts and need & own for need in kind.needs):
        return False
    return not kind.is_flag or signal.length == 1


def _is_of(kind: QuantityWords, signal: Signal) -> bool:
    """Whether a signal's unit, if known, is a unit of a kind of quantity."""
    dimensions = dimensions_named((signal.unit or "").strip())
    return not kind.dimensions or not dimensions or bool({*dimensions} & {*kind.dimensions})


def _best(candidates: Sequence[SignalCandidate], speaks_of_gate: bool) -> list[SignalCandidate]:
    """Return the best candidates of a quantity: by fitting unit, then exact name, then a name with "gate"."""
    tests = (
        lambda each: each.fits,
        lambda each: each.is_named,
        lambda each: (
            not speaks_of_gate or "gate" in concepts_in(each.message.name) | concepts_in(each.signal.name)
        ),
    )
    kept = list(candidates)
    for test in tests:
        kept = [each for each in kept if test(each)] or kept
    return kept

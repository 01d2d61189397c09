"""Section [inject] of a rig file: messages by which a test bench injects faults, requests and signal values.

So a panel can inject faults, send requests to the ECU or set a signal. The labels of a message
decide: kinds of faults and requests go by their names, places by a drive, a message or a key of the vehicle file,
signals by `Message.Signal`. So another place is one more line of the database.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from liftgate_hil.codec.bus_config import identifier_of
from liftgate_hil.codec.protection import MessageOptions
from liftgate_hil.config.described import Field, Record, read_record
from liftgate_hil.config.kinds import Text
from liftgate_hil.config.restbus import check_signal
from liftgate_hil.config.signal_name import find_signal
from liftgate_hil.config.toml import Table, known_keys, show, table
from liftgate_hil.errors import ConfigIssues
from liftgate_hil.stimuli.requests import REQUESTS
from liftgate_hil.stimuli.restbus import BusTables

if TYPE_CHECKING:
    from cantools.database.can import Signal as DatabaseSignal

NOTHING = "none"  # the label that selects nothing
_SIGNAL = Text("MESSAGE.SIGNAL")

# fmt: off
# A field with its key is a row of a table.


class FaultOrder(Record):
    """The keys of the table `[inject.fault]` of a rig."""

    kind: Annotated[str, Field(_SIGNAL, "its labels are fault kinds of docs/scenario.md; `none` with `on` 0 ends "
        "all faults")]
    on: Annotated[str, Field(_SIGNAL, "1: the fault begins, or begins again with another value; 0: it ends")]
    place: Annotated[str | None, Field(_SIGNAL, "its labels are left, right, both, messages, keys of the vehicle "
        "file (for the kind `parameter`), and `none`", "none")] = None
    value: Annotated[str | None, Field(_SIGNAL, "number for the kind's key: value, ohm, factor, probability, "
        "rate, delay_s, or the number of the bridge state", "none")] = None
    direction: Annotated[str | None, Field(_SIGNAL, "its labels are sent and received, as seen from the gate; "
        "with any other label the message in `place` decides", "none")] = None


class BabblingOrder(Record):
    """The keys of the table `[inject.babbling]` of a rig."""

    identifier: Annotated[str, Field(_SIGNAL, "identifier of the frames, above 0x7FF an extended one")]
    on: Annotated[str, Field(_SIGNAL, "1: babbling begins; 0: it ends")]
    rate: Annotated[str, Field(_SIGNAL, "rate of the frames [1/s]")]
    direction: Annotated[str, Field(_SIGNAL, "its labels are sent and received")]


class RequestOrder(Record):
    """The keys of the table `[inject.request]` of a rig."""

    action: Annotated[str, Field(_SIGNAL,
        "its labels are the rig's buttons: open, close, stop, reset, and `none`")]


class SignalOrder(Record):
    """The keys of the table `[inject.signal]` of a rig."""

    name: Annotated[str, Field(_SIGNAL, "its labels are signals of the database that the bench may send, as "
        "Message.Signal")]
    value: Annotated[str, Field(_SIGNAL, "new value of that signal, in the database's unit")]


# fmt: on
FAULT, BABBLING, REQUEST, SIGNAL = "fault", "babbling", "request", "signal"
ORDERS: Mapping[str, type] = {
    FAULT: FaultOrder,
    BABBLING: BabblingOrder,
    REQUEST: RequestOrder,
    SIGNAL: SignalOrder,
}


@dataclass(frozen=True)
class OrderMessage:
    """A message of the test bench that gives an order if it holds all of these signals."""

    what: str  # key of ORDERS
    message: str
    identifier: int  # with SocketCAN's flag if it is extended
    signals: Mapping[str, str]  # name of the signal by the key of its order's table
    labels: tuple[str, ...] = ()  # what can be ordered: kinds, actions, names of signals


def orders_of(
    given: Table, tables: BusTables, taken: Sequence[str], issues: ConfigIssues
) -> tuple[OrderMessage, ...]:
    """Return the messages of [inject]; issues are noted. `taken` are the messages that gate or ECU send."""
    known_keys(issues, "inject", given, ORDERS)
    found = [_order(what, given[what], tables, taken, issues) for what in ORDERS if what in given]
    return tuple(each for each in found if each is not None)


def _order(
    what: str, given: object, tables: BusTables, taken: Sequence[str], issues: ConfigIssues
) -> OrderMessage | None:
    """Return the message of the order `what`; None and an issue if its keys or signals are invalid."""
    key, before = f"inject.{what}", issues.count
    read: object = read_record(issues, key, table(issues, key, given), ORDERS[what])
    values: dict[str, str | None] = dict(vars(read))
    if issues.count > before:
        return None
    signals = {
        name: find_signal(issues, f"{key}.{name}", signal_path, tables.messages)
        for name, signal_path in values.items()
        if signal_path is not None
    }
    messages = list(dict.fromkeys(signal_path.partition(".")[0] for signal_path in values.values() if signal_path))
    if issues.count > before:
        return None
    if len(messages) > 1:
        issues.add(key, f"signals of {', '.join(messages)}; allowed: signals of one message")
        return None
    message, options = messages[0], tables.options.get(messages[0], MessageOptions())
    if message in {each.message for each in tables.outputs}:
        issues.add(key, f"{message}: the gate sends it; allowed: a message of the test bench")
    if options.counter or options.checksum or options.e2e:
        issues.add(key, f"{message} is protected; allowed: a message without counter and checksum")
    labels = _labels(key, what, signals, tables, taken, issues)
    return OrderMessage(
        what,
        message,
        identifier_of(tables.messages[message]),
        {name: each.name for name, each in signals.items() if each is not None},
        labels,
    )


def _labels(
    key: str,
    what: str,
    signals: "Mapping[str, DatabaseSignal | None]",
    tables: BusTables,
    taken: Sequence[str],
    issues: ConfigIssues,
) -> tuple[str, ...]:
    """Return the labels, except `none`, of the signal that selects an order's subject; issues are noted."""
    name, known = {
        FAULT: ("kind", []),  # checked in rig_fit
        REQUEST: ("action", list(REQUESTS)),
        SIGNAL: ("name", []),
    }.get(what, ("direction", ["sent", "received"]))
    signal = signals[name]
    assert signal is not None
    labels = [str(each) for each in (signal.choices or {}).values() if str(each) != NOTHING]
    wrong = [each for each in labels if known and each not in known]
    for label in labels if what == SIGNAL else []:
        check_signal(f"{key}.{name}: {signal.name}", label, tables, taken, issues)
    if not labels or wrong:
        text = ", ".join(map(show, wrong)) if wrong else "no value table"
        allowed = ", ".join(known) or "a signal with a value table"
        issues.add(f"{key}.{name}", f"{signal.name}: {text}; allowed: {allowed}")
    return tuple(labels)

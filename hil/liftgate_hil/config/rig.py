"""A rig file: which signal of which database carries which quantity."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated

from liftgate_hil.codec.bus_config import SignalMapping, build_bus_config, identifier_of
from liftgate_hil.codec.messages import Messages
from liftgate_hil.codec.protection import MessageOptions
from liftgate_hil.codec.sending import LONGEST_MS, SendType, cycle_of, needs_fd, send_type_of, timeout_of
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.config.database import KINDS, find_database, load_messages
from liftgate_hil.config.described import Field, Record, fields_of, read_record
from liftgate_hil.config.driver import NO_DRIVER, DriverButtons, buttons_of, diagnostics_of, reset_of
from liftgate_hil.config.inject import SIGNAL, OrderMessage, orders_of
from liftgate_hil.config.kinds import Number, Subtable, Text
from liftgate_hil.config.messages import message_options
from liftgate_hil.config.restbus import sendable
from liftgate_hil.config.signal_mapping import signal_mappings
from liftgate_hil.config.toml import Table, check_kind, read_toml, show
from liftgate_hil.diagnostics.tester import Diagnostics
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_hil.signals import BUS_INPUTS, BUS_OUTPUTS
from liftgate_hil.stimuli.restbus import BusTables
from liftgate_plant.signals import Signal

DEFAULT_BITRATE = 500_000.0  # bit/s
_COMMAND_MS = 10.0  # cycle of the command on the shipped bus

COMMANDS = ("left_duty", "right_duty", "left_direction", "right_direction")


# fmt: off
# A field with its key is a row of a table.


class RigTable(Record):
    """The top-level keys of a rig file."""

    dbc: Annotated[str, Field(Text("a DBC, ARXML, KCD or SYM file"), "CAN database: a file beside the rig file, "
        "or a shipped one (`liftgate.dbc`); `their.kcd#Body`: the bus `Body` of a file with several")]
    bitrate: Annotated[float, Field(Number(1.0, 1e8, "bit/s"), "bit rate with which the bus is opened, and to "
        "which the bus load is related")] = DEFAULT_BITRATE
    inputs: Annotated[Table | None, Field(Subtable(), "quantities that the gate receives, see below")] = None
    outputs: Annotated[Table | None, Field(Subtable(), "quantities that the gate sends, see below")] = None
    messages: Annotated[Table | None, Field(Subtable(), "a table for each message: cycle, time-out and "
        "protection, see below")] = None
    requests: Annotated[Table | None, Field(Subtable(), "a table for each button of the driver, for an ECU on a "
        "bus, see below")] = None
    reset: Annotated[Table | None, Field(Subtable(), "how an ECU on a bus is reset, see below")] = None
    inject: Annotated[Table | None, Field(Subtable(), "messages by which a test bench acts on the running gate, "
        "see below")] = None
    diagnostics: Annotated[Table | None, Field(Subtable(),
        "how the ECU's trouble codes are read, see below")] = None


# fmt: on
@dataclass(frozen=True)
class Rig:
    """A rig file as read, checked against its database."""

    database: Path
    bitrate: float
    messages: Messages
    inputs: tuple[SignalMapping, ...]
    outputs: tuple[SignalMapping, ...]
    options: Mapping[str, MessageOptions]
    is_fd: bool
    source: str
    diagnostics: Diagnostics | None = None  # how trouble codes are read from the ECU
    driver: DriverButtons = NO_DRIVER
    orders: tuple[OrderMessage, ...] = ()  # messages by which a test bench injects

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the messages of the database that are left out because of errors."""
        return tuple(f"{self.database}: {note}" for note in self.messages.notes)

    @cached_property
    def tables(self) -> BusTables:
        """The messages, mapped outputs and options by which the bench sends frames."""
        return BusTables(self.messages, self.outputs, self.options, self.source)

    @property
    def settable(self) -> tuple[str, ...]:
        """The signals that may be set during a run, by a test bench or for requests."""
        names = [each.signal for each in self.driver.buttons.values()]
        if self.driver.reset is not None and self.driver.reset.press is not None:
            names.append(self.driver.reset.press.signal)
        names += [label for each in self.orders if each.what == SIGNAL for label in each.labels]
        return tuple(dict.fromkeys(names))

    @cached_property
    def sendable(self) -> tuple[str, ...]:
        """All signals of the database that the bench may send as restbus."""
        return sendable(self.tables, self.mapped, self.is_fd)

    @property
    def ordering(self) -> tuple[int, ...]:
        """Identifiers of the messages by which a test bench injects, with SocketCAN's flag if extended."""
        return tuple(dict.fromkeys(each.identifier for each in self.orders))

    @property
    def mapped(self) -> tuple[str, ...]:
        """Names of the messages that carry inputs and outputs."""
        return tuple(dict.fromkeys(wire.message for wire in (*self.inputs, *self.outputs)))

    def input_config(self, sending: bool = False) -> BusConfig:
        """Return the tables, shared and never changed, for receiving the inputs; `sending`: for sending them."""
        return self._bus_config("inputs", self.inputs, BUS_INPUTS, sending)

    def output_config(self, sending: bool = True) -> BusConfig:
        """Return the tables, shared and never changed, for `sending` the outputs; else for receiving them."""
        return self._bus_config("outputs", self.outputs, BUS_OUTPUTS, sending)

    def _bus_config(
        self, section: str, mappings: tuple[SignalMapping, ...], quantities: Mapping[str, Signal], sending: bool
    ) -> BusConfig:
        """Return the tables of a section, made once. Raises ConfigError."""
        if (section, sending) not in self._configs:
            issues = ConfigIssues(self.source)
            bus = build_bus_config(self.messages, mappings, self.options, quantities, issues, sending)
            issues.raise_if_any()
            self._configs[section, sending] = bus
        return self._configs[section, sending]

    @cached_property
    def _configs(self) -> dict[tuple[str, bool], BusConfig]:
        """Cache of the tables of inputs and outputs, by section and by whether the messages are sent."""
        return {}

    def range_held(self, wire: SignalMapping) -> tuple[float, float]:
        """Return the range of a mapped quantity that its signal can hold after rounding [the quantity's unit]."""
        place = wire.message, wire.signal, wire.quantity
        if place not in self._ranges:
            signal = self.messages[wire.message].get_signal_by_name(wire.signal)
            low, high = wire.quantity_range(signal)
            half = 0.5 * abs(wire.scale * float(signal.scale)) * (not signal.is_float)
            self._ranges[place] = low - half, high + half
        return self._ranges[place]

    @cached_property
    def _ranges(self) -> dict[tuple[str, str, str], tuple[float, float]]:
        """Cache of the ranges by `range_held`, by message, signal and quantity."""
        return {}

    def command_message(self) -> str:
        """Return the name of the message that carries the motor command."""
        return next(wire.message for wire in self.inputs if wire.quantity == "left_duty")

    def command_identifier(self) -> int:
        """Return the identifier of the motor command's message, with SocketCAN's flag if extended."""
        return self.identifier(self.command_message())

    def message_at(self, place: str, is_sent: bool, is_received: bool) -> str:
        """Return the name of the message that is called `place` or carries the quantity `place`; else `place`.

        An input and an output may be the same quantity: of `is_sent` and `is_received`, that which holds counts.
        """
        mappings = (*(self.inputs if is_received else ()), *(self.outputs if is_sent else ()))
        if place in self.messages:
            return place
        return next((each.message for each in mappings if each.quantity == place), place)

    def identifier(self, name: str) -> int:
        """Return the identifier of a message, with SocketCAN's flag if it is extended."""
        return identifier_of(self.messages[name])

    def command_cycle_ms(self) -> float:
        """Return the period at which an ECU sends the motor command [ms].

        This is the message's cycle; without one (sent on events) that of the left motor's current, or 10 ms.
        """
        return self.cycle_ms(self.command_message()) or self.current_cycle_ms() or _COMMAND_MS

    def current_cycle_ms(self) -> float:
        """Return the cycle of the message with the left motor's current [ms]; 0 if it has none or is not sent."""
        names = [wire.message for wire in self.outputs if wire.quantity == "left_current"]
        return self.cycle_ms(names[0]) if names else 0.0

    def cycle_ms(self, name: str) -> float:
        """Return the cycle of a message [ms]; 0 if it has none."""
        return cycle_of(self.messages[name], self.options.get(name, MessageOptions()))

    def timeout_ms(self, name: str) -> float:
        """Return the time without a frame after which a message's last values expire [ms]; 0: never."""
        return timeout_of(self.messages[name], self.options.get(name, MessageOptions()))


def load_rig(path: Path) -> Rig:
    """Read and return the rig of a file. Raises ConfigError with all issues of the file."""
    rig, issues = read_rig(path)
    issues.raise_if_any()
    return rig


def read_rig(path: Path) -> tuple[Rig, ConfigIssues]:
    """Read a rig file; return the rig, as far as readable, and its issues. Raises ConfigError if it is no rig.

    No rig is what is not TOML, e.g. a database, or of another kind.
    """
    if path.suffix.lower() in KINDS:
        raise ConfigError(
            f"{path}: a database, not a rig; allowed: a rig in TOML "
            f"(liftgate-hil rig draft {path.name} writes a first one)"
        )
    content = read_toml(path)
    check_kind(path, content, "rig", [key.name for key in fields_of(RigTable)])
    return rig_of_content(content, path)


def rig_of_content(raw: Table, path: Path, messages: Messages | None = None) -> tuple[Rig, ConfigIssues]:
    """Return the rig of a file's parsed content, as far as it can be read, and its issues.

    `path` names the content, and the database is looked for beside it; `messages` are the database's messages if
    they have been read before.
    """
    issues = ConfigIssues(str(path))
    given = read_record(issues, "", raw, RigTable)
    database = find_database(issues, given.dbc, path.parent) if given.dbc else None
    before = issues.count
    if messages is None:
        messages = load_messages(issues, database) if database else Messages()
    file = database.path if database else Path()
    if not messages or issues.count > before:  # without a valid database nothing else can be checked
        return Rig(file, given.bitrate, Messages(), (), (), {}, False, str(path)), issues
    inputs = signal_mappings(issues, given.inputs or {}, "inputs", BUS_INPUTS, messages)
    outputs = signal_mappings(issues, given.outputs or {}, "outputs", BUS_OUTPUTS, messages)
    options = message_options(issues, given.messages or {}, messages)
    wires = (*inputs, *outputs)
    mapped = {identifier_of(messages[wire.message]): wire.message for wire in wires}
    rig = Rig(
        file,
        given.bitrate,
        messages,
        tuple(inputs),
        tuple(outputs),
        options,
        any(needs_fd(messages[wire.message]) for wire in wires),
        str(path),
        diagnostics_of(issues, given.diagnostics, messages, mapped),
    )
    _check_whole(issues, rig)
    buttons = buttons_of(given.requests or {}, rig.tables, rig.mapped, issues)
    reset = reset_of(given.reset, rig.tables, rig.mapped, rig.diagnostics is not None, issues)
    orders = orders_of(given.inject or {}, rig.tables, rig.mapped, issues)
    rig = replace(rig, driver=DriverButtons(buttons, reset), orders=orders)
    for make in (rig.input_config, rig.output_config):
        try:
            make()
        except ConfigError as error:
            issues.take(issues.unsettled(error.issues))
    return rig, issues


def _check_whole(issues: ConfigIssues, rig: Rig) -> None:
    """Note issues of a rig as a whole, which no single line of the file shows."""
    mapped = {wire.quantity for wire in rig.inputs}
    if "left_duty" not in mapped:
        issues.add("inputs.left_duty", "missing; allowed: the signal with the left motor's duty")
    for wire in rig.inputs:
        if wire.quantity.endswith("_duty") and wire.basis != "unknown":
            _check_duty(issues, rig, wire, mapped)
        if wire.quantity.endswith("_direction"):
            _check_direction(issues, wire)
    received = {wire.message for wire in rig.inputs}
    for wire in rig.outputs:
        if wire.message in received:
            issues.add(
                f"outputs.{wire.quantity}",
                f"{wire.message} carries inputs too; allowed: a message that nobody else sends",
            )
    for name in dict.fromkeys(wire.message for wire in rig.outputs):
        message = rig.messages[name]
        if _is_diagnostic(message.frame_id, message.is_extended_frame):
            issues.add(
                f"outputs in {name}",
                f"identifier 0x{message.frame_id:X}; allowed: none that cars use for diagnostics (0x7DF to 0x7EF, "
                "0x18DAxxxx, 0x18DBxxxx)",
            )
    sent = {wire.message for wire in rig.outputs}
    commands = {wire.message for wire in rig.inputs if wire.quantity in COMMANDS}
    for name in sorted(sent | received):
        own = rig.options.get(name, MessageOptions())
        cycle = cycle_of(rig.messages[name], own)
        if own.cycle_ms is not None:
            continue
        is_event = send_type_of(rig.messages[name], own) is SendType.EVENT
        if not cycle and (name in sent or (name in commands and not is_event)):
            why = "sent on events" if is_event else "without a cycle (GenMsgCycleTime)"
            issues.add(
                f"messages.{name}.cycle_ms",
                f"missing, and by the database {name} is {why}; allowed: 0.1 to 60000 ms",
            )
        elif not 0 <= cycle <= LONGEST_MS:
            issues.add(
                f"messages.{name}.cycle_ms",
                f"the database's GenMsgCycleTime is {show(rig.messages[name].cycle_time)}; "
                "allowed: up to 60000 ms",
            )


def _check_duty(issues: ConfigIssues, rig: Rig, wire: SignalMapping, mapped: set[str]) -> None:
    """Note an issue if a duty is unsigned and has no direction signal: its sign is then the motor's direction."""
    direction = wire.quantity.replace("_duty", "_direction")
    low, high = wire.quantity_range(rig.messages[wire.message].get_signal_by_name(wire.signal))
    if direction not in mapped and not low < 0.0 < high:
        taken = {other.signal for other in rig.inputs if other.message == wire.message}
        signals = rig.messages[wire.message].signals
        named = [f"{wire.message}.{each.name}" for each in signals if each.choices and each.name not in taken]
        hint = f" (with labels: {', '.join(named)})" if named else ""
        issues.add(
            f"inputs.{direction}",
            f"missing, and {wire.message}.{wire.signal} is {low:g} to {high:g} %, so the motor turns one way "
            f"only; allowed: a signal with the direction{hint}, or a {wire.quantity} that is signed",
        )


def _check_direction(issues: ConfigIssues, wire: SignalMapping) -> None:
    """Note an issue if a direction has neither open nor close: with one, the duty's sign is ignored."""
    if wire.values is not None and not {"open", "close"} & set(wire.values):
        issues.add(
            f"inputs.{wire.quantity}.values",
            f"{', '.join(wire.values)}: the motor could never be driven; allowed: with open and close; without "
            "a direction the sign of the duty is it, and a duty of 0 brakes",
        )


def _is_diagnostic(identifier: int, is_extended: bool) -> bool:
    """Whether cars use an identifier for diagnostics: 0x7DF to 0x7EF; of 29 bits 0x18DAxxxx, 0x18DBxxxx."""
    if is_extended:
        return identifier >> 16 in (0x18DA, 0x18DB)
    return 0x7DF <= identifier <= 0x7EF

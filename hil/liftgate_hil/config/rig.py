"""A rig file: which signal of which database carries which quantity."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from liftgate_hil.codec.bus_config import SignalMapping, build_bus_config, needs_fd
from liftgate_hil.codec.frames import EXTENDED
from liftgate_hil.codec.protection import MessageOptions
from liftgate_hil.codec.tables import BusConfig
from liftgate_hil.config.messages import message_options
from liftgate_hil.config.shipped import data_root
from liftgate_hil.config.toml import Table, known_keys, number, read_toml, show, table, text
from liftgate_hil.errors import ConfigError
from liftgate_hil.issues import ConfigIssues
from liftgate_hil.signals import BUS_INPUTS, BUS_OUTPUTS
from liftgate_plant.signals import Signal

if TYPE_CHECKING:
    from cantools.database.can import Message

COMMANDS = ("left_duty", "right_duty", "left_direction", "right_direction")


@dataclass(frozen=True)
class Rig:
    """A rig, checked against its database."""

    database: Path
    bitrate: float
    messages: Mapping[str, Message]
    inputs: tuple[SignalMapping, ...]
    outputs: tuple[SignalMapping, ...]
    options: Mapping[str, MessageOptions]
    is_fd: bool
    source: str

    def input_config(self, sending: bool = False) -> BusConfig:
        """The inputs' tables: received by the emulator, sent by an ECU."""
        return self._bus_config(self.inputs, BUS_INPUTS, sending)

    def output_config(self, sending: bool = True) -> BusConfig:
        """The outputs' tables: sent by the emulator, received by an ECU."""
        return self._bus_config(self.outputs, BUS_OUTPUTS, sending)

    def _bus_config(
        self,
        mappings: tuple[SignalMapping, ...],
        quantities: Mapping[str, Signal],
        sending: bool,
    ) -> BusConfig:
        issues = ConfigIssues(self.source)
        bus = build_bus_config(self.messages, mappings, self.options, quantities, issues, sending)
        issues.raise_if_any()
        return bus

    def command_message(self) -> str:
        """The message with the motor command."""
        return next(wire.message for wire in self.inputs if wire.quantity == "left_duty")

    def command_identifier(self) -> int:
        """Its identifier, with SocketCAN's flag where it is extended."""
        message = self.messages[self.command_message()]
        return message.frame_id | (EXTENDED if message.is_extended_frame else 0)

    def command_cycle_ms(self) -> float:
        """Its cycle."""
        name = self.command_message()
        given = self.options.get(name, MessageOptions()).cycle_ms
        return float(given if given is not None else self.messages[name].cycle_time or 0)


def load_rig(path: Path) -> Rig:
    """The rig of a file. Raises ConfigError with all faults of the file."""
    raw = read_toml(path)
    issues = ConfigIssues(str(path))
    known_keys(issues, "", raw, ("dbc", "bitrate", "inputs", "outputs", "messages"))
    database = _find_database(issues, raw.get("dbc"), path.parent)
    bitrate = number(issues, "bitrate", raw.get("bitrate", 500_000), 1.0, 1e8, "bit/s")
    messages = _load_messages(issues, database) if database else {}
    if not messages:
        issues.raise_if_any()
    inputs = _mappings(issues, raw, "inputs", BUS_INPUTS, messages)
    outputs = _mappings(issues, raw, "outputs", BUS_OUTPUTS, messages)
    options = message_options(issues, raw, messages)
    rig = Rig(
        database or Path(),
        bitrate,
        messages,
        tuple(inputs),
        tuple(outputs),
        options,
        any(needs_fd(messages[wire.message]) for wire in (*inputs, *outputs)),
        str(path),
    )
    _check_whole(issues, rig)
    issues.raise_if_any()
    for make in (rig.input_config, rig.output_config):
        with _collecting(issues):
            make()
    issues.raise_if_any()
    return rig


@contextlib.contextmanager
def _collecting(issues: ConfigIssues) -> Iterator[None]:
    try:
        yield
    except ConfigError as error:
        issues.lines += error.issues


def _find_database(issues: ConfigIssues, value: object, folder: Path) -> Path | None:
    name = text(issues, "dbc", value)
    if not name:
        return None
    for path in (folder / name, data_root() / "dbc" / name):
        if path.is_file():
            return path
    issues.add("dbc", f"{show(name)}: no such file beside the rig or among the shipped ones")
    return None


class _Collector(logging.Handler):
    """Keeps what is logged."""

    def __init__(self) -> None:
        super().__init__()
        self.records: list[logging.LogRecord] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.records.append(record)


def _load_messages(issues: ConfigIssues, path: Path) -> dict[str, Message]:
    from liftgate_hil.python_can import cantools

    # cantools only logs what makes a database ambiguous; here that is a fault.
    handler = _Collector()
    logger = logging.getLogger("cantools")
    logger.addHandler(handler)
    try:
        database = cantools.database.load_file(path)
    except (cantools.Error, ValueError, OSError, UnicodeError) as error:
        issues.add("dbc", f"{path}: cannot be read: {' '.join(str(error).split())[:200]}")
        return {}
    finally:
        logger.removeHandler(handler)
    if not isinstance(database, cantools.database.can.Database):
        issues.add("dbc", f"{path}: allowed: a CAN database")
        return {}
    for record in handler.records:
        if "Overwriting" in record.getMessage():
            issues.add("dbc", f"{path}: ambiguous: {record.getMessage()}")
    return {message.name: message for message in database.messages}


def _mappings(
    issues: ConfigIssues,
    raw: Table,
    section: str,
    quantities: Mapping[str, Signal],
    messages: Mapping[str, Message],
) -> list[SignalMapping]:
    given = table(issues, section, raw.get(section, {}))
    known_keys(issues, section, given, quantities)
    mappings = []
    for quantity, value in given.items():
        if quantity in quantities:
            wire = _mapping(issues, f"{section}.{quantity}", quantity, value, messages)
            if wire is not None:
                mappings.append(wire)
    return mappings


def _mapping(
    issues: ConfigIssues, key: str, quantity: str, value: object, messages: Mapping[str, Message]
) -> SignalMapping | None:
    given: dict[str, Any] = value if isinstance(value, dict) else {"signal": value}
    known_keys(issues, key, given, ("signal", "scale", "offset", "values"))
    name = text(issues, f"{key}.signal", given.get("signal"))
    if not name:
        return None
    scale = number(issues, f"{key}.scale", given.get("scale", 1.0), -1e9, 1e9)
    offset = number(issues, f"{key}.offset", given.get("offset", 0.0), -1e9, 1e9)
    if scale == 0.0:
        issues.add(f"{key}.scale", "0; allowed: anything else")
    values = given.get("values")
    if values is not None:
        values = table(issues, f"{key}.values", values)
        for label, each in values.items():
            if not isinstance(each, str):
                number(issues, f"{key}.values.{label}", each, -1e15, 1e15)
    message, dot, signal = name.partition(".")
    if not dot or message not in messages:
        allowed = ", ".join(sorted(messages)[:20])
        issues.add(key, f"{show(name)}: no such message; allowed: MESSAGE.SIGNAL of {allowed}")
        return None
    signals = [each.name for each in messages[message].signals]
    if signal not in signals:
        issues.add(key, f"{show(name)}: no such signal; allowed: {', '.join(signals)}")
        return None
    return SignalMapping(quantity, message, signal, scale, offset, values)


def _check_whole(issues: ConfigIssues, rig: Rig) -> None:
    """What no single line of the file shows."""
    mapped = {wire.quantity for wire in rig.inputs}
    if "left_duty" not in mapped:
        issues.add("inputs.left_duty", "missing; allowed: the signal with the left motor's duty")
    received = {wire.message for wire in rig.inputs}
    for wire in rig.outputs:
        if wire.message in received:
            issues.add(
                f"outputs.{wire.quantity}",
                f"{wire.message} carries inputs too; allowed: a message that nobody else sends",
            )
    cyclic = {wire.message for wire in rig.outputs}
    cyclic |= {wire.message for wire in rig.inputs if wire.quantity in COMMANDS}
    for name in sorted(cyclic | received):
        given = rig.options.get(name, MessageOptions()).cycle_ms
        told = rig.messages[name].cycle_time or 0
        if given is not None:
            continue
        if not told and name in cyclic:
            issues.add(
                f"messages.{name}.cycle_ms",
                "missing, and the database has no GenMsgCycleTime; allowed: 0.1 to 60000 ms",
            )
        elif not 0 <= told <= 60_000:
            issues.add(
                f"messages.{name}.cycle_ms",
                f"the database's GenMsgCycleTime is {show(told)}; allowed: up to 60000 ms",
            )

"""Page docs/rig.md: all keys of a rig file, from the schema by which such files are read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from liftgate_hil.config.driver import ButtonTable, DiagnosticsTable, ResetTable
from liftgate_hil.config.inject import ORDERS
from liftgate_hil.config.messages import MessageTable, StateMachineTable
from liftgate_hil.config.own_protection import ChecksumTable, CounterTable
from liftgate_hil.config.rig import RigTable
from liftgate_hil.config.signal_mapping import MappingTable
from liftgate_hil.diagnostics.trouble_code import number_of
from liftgate_hil.ecu.events import TROUBLE_CODES, EcuDtc
from liftgate_hil.signals import BUS_INPUTS, BUS_OUTPUTS
from liftgate_plant.signals import Signal
from tools.docs.markdown import code, number, page, table
from tools.docs.schema import key_table

_INTRO = """\
A rig file is written in TOML. It maps the quantities of the emulator to the signals of a CAN database. It is
used by `--rig`, a scenario's `rig` and `liftgate_hil.Gate(rig=…)`.
[`liftgate.toml`](../configs/rigs/liftgate.toml) is the default; `liftgate-hil init` copies it. The gate and the
reference ECU pack and check messages by the same file.

A quantity is mapped by `quantity = "MESSAGE.SIGNAL"`, or by a table if the signal differs from the quantity in
unit, scale or values."""

_DATABASE = """\
DBC, ARXML, KCD and SYM (version 5.0 and 6.0) are read by cantools. Faulty parts of a
file are left out. A note of `rig check`, `rig draft`, `judge`, `convert`, `plot` and `compare` names each of them
with the reason and, in a DBC, the line:

- A message whose signals overlap or go beyond its end, that has the name or the identifier of another one, or that
  a line defines which is not understood. It is refused where the rig uses it.
- A line of a DBC that defines no message, such as a comment or an attribute; the message that it is about stays.

An identifier above 0x7FF is one of 29 bits, also where a DBC, KCD or SYM does not mark it so, which a note says.

A file with several buses is refused with their names; `dbc = "their.kcd#Body"` takes the messages of one. A
database in place of a rig (`convert --rig`, `judge --rig`) and `rig draft` take the same form.

Send types count (`GenMsgSendType`, else `GenSigSendType` of the signals): a message that is sent on events has no
cycle, whatever `GenMsgCycleTime` is by default, and what the gate received with it holds until the next frame. One
that is cyclic while active does not expire either. `cycle_ms` of the rig makes any message cyclic.

Messages of J1939 are matched and sent by their whole identifier, not by their PGN: the addresses in the database
must be those of the bus."""

_CHECKSUM = """\
A cyclic redundancy check (CRC) that is defined by the parameters of the Rocksoft model (R. N. Williams, 1993).
The Catalogue of parametrised CRC algorithms (G. Cook) lists such parameters; all its algorithms of up to 64 bits
are verified against its check values. The named kinds remain available: `checksum = "Checksum"` with
`checksum_kind`.

    [messages.TheirCommand]
    counter = "BZ"

    [messages.TheirCommand.checksum]
    signal = "CRC"
    width = 8
    polynomial = 0x2F
    start = 0xFF
    final_xor = 0xFF
    covers = ["payload", "data_id"]
    data_id = 0x86

`covers` lists the parts that the checksum covers. Their bytes are processed in the order of that list:

- `"payload"`: all bytes of the frame except those that the checksum fills completely. `"payload 1 to 7"`: these
  bytes, both ends included; byte 0 is the first of the frame. `"payload 7 to 1"`: the same bytes in reverse
  order. `"payload 3"`: one byte. If a covered byte contains bits of the checksum, these count as 0.
- `"identifier"`: the identifier of the frame, two bytes; four bytes for an extended one.
- `"counter"`: the value of the counter, in as many bytes as its signal needs.
- `"data_id"`: the data ID, in as many bytes as the largest one of the list needs.

In the last three, byte 0 is the least significant one and comes first. `"identifier 1 to 0"` puts the more
significant byte first; `"data_id 0 to 1"` takes two bytes whatever the value. The byte order of the checksum is
that of its signal. `rig check` prints the result."""

_MAKERS = """\
According to open DBC projects, this covers the following manufacturers:

- Volkswagen MQB and MEB: polynomial 0x2F, `covers = ["payload", "data_id"]`, a list of 16 data IDs by the
  counter.
- FCA Giorgio and Rivian: 0x1D, another `final_xor` for each message.
- Chrysler and Nissan: 0x1D, `start` and `final_xor` 0xFF.
- Hyundai LKAS11: 0x1D, `start` 0x22, `final_xor` 0xDF.
- Hyundai CAN FD: 0x1021 of 16 bits, `covers = ["payload", "identifier"]`, `final_xor` by the length.

Subaru and Tesla use the named kind `sum8`. Sums and exclusive ors other than `sum8` and `xor8` are not cyclic
checks and cannot be described: Toyota (a sum with the length), Honda and PSA (sums of half bytes), Hyundai's
sums without the identifier, Volkswagen PQ, Ford. Leave such a message without `checksum`: it is received
unchecked, and sent with the start value of that signal."""

_COUNTER = """\
An alive counter with any width, start value and step. Frames that are missing between two received values are
counted as `lost`. A frame with a value that the counter never has is rejected and counted as `counter`."""

_INJECT = """\
Messages by which a panel of CANoe, BUSMASTER or SavvyCAN, or a script, acts on the running gate: it injects a
fault, presses a button of `[requests]`, or sets a signal of the restbus. A frame that contains all signals of
one of these tables is an order. In the shipped database the orders are the multiplexer pages of `BenchInject`
(0x6E4). The labels in the database's value tables decide what can be ordered: to offer a further message, key or
signal, add a label.

- An order takes effect from the next tick on; in real time within a few milliseconds, since it is read beside
  the loop.
- A fault has the same meaning as in a scenario. It acts after the faults of the scenario and after faults that
  were ordered before. The same order with another value starts the fault again; an identical order changes
  nothing. To end a fault, send its kind and place (and its direction, if it has one) with `on` 0 and any value.
  Up to 32 ordered faults may be active at the same time.
- A message with an ordered signal is sent from the signal's first value on, with the start values of its other
  signals.
- A request presses the rig's button. `reset` resets the ECU as in the middle of a scenario.
- Orders are counted; the first 1000 are reported and listed in the summary (`injected`). A wrong order is
  reported and counted, too, and changes nothing.
- Before a scenario's time 0 no orders are read. On the free clock there is no test bench to send any."""

_DIAGNOSTICS = """\
If a scenario expects a trouble code (`[[expect]] dtc`), the bench's tester reads the codes of the ECU under
test. It uses UDS (ISO 14229-1) over ISO-TP (ISO 15765-2) with normal addressing and classic CAN frames. On every
clock it works in model time and sends its frames along with those of the gate.

The tester sends ClearDiagnosticInformation for all groups (`14 FF FF FF`) until this succeeds (unless `clear =
false`), then ReadDTCInformation by status mask (`19 02`) in each cycle. It makes one request at a time and
repeats a refused one a cycle later. Apart from the ECUReset of `[reset]` it makes no other requests: the codes
must be readable in the default session. A code is known only after it has been read, so choose windows
(`within_s`) that leave room for one `cycle_ms`.

The identifiers may be those that cars use for diagnostics (0x7E0 to 0x7EF), which no message of the gate may
have. They must not carry quantities of this rig. `Gate.read_dtcs` and `Gate.clear_dtcs` make the same two
requests, each once."""

_ECU_RESET = """\
`uds` needs `[diagnostics]` and the package's extra `uds`. `hardReset` is the request `11 01` with the positive
response `51 01`; `keyOffOnReset` is `11 02`, `softReset` is `11 03`. The request is made in the present session
of the ECU, without security access.

- Before a scenario, the request is repeated after each `[diagnostics] timeout_ms` without a response, until
  `timeout_s`, since the ECU may still be starting.
- In the middle of a scenario, it is made once, after the tester's previous request has been answered. If it is
  refused or not answered, the scenario's expectations are inconclusive.
- After "response pending" (NRC 0x78) the tester waits 5 s more. After "busy, repeat request" (0x21) it repeats
  the request a `cycle_ms` later. Any other negative response is final.
- In the 0.1 s after the positive response the ECU may still be shutting down. In this time neither a command
  counts as the ECU's first one, nor is `ready` evaluated. An ECU that takes longer needs a `ready` that detects
  its restart."""

_ECU = """\
With `[diagnostics]` the reference ECU answers these requests, and those of any other tester:

- default and extended session (`10 01`, `10 03`),
- hard reset (`11 01`),
- clear all codes or one (`14`),
- count codes and read them by status mask (`19 01`, `19 02`),
- tester present (`3E 00`).

It rejects all others as the standard requires. Its codes are in the format of SAE J2012 with the failure type,
from the manufacturer-specific ranges:"""

_STATUS = """\
An event is a failed test: testFailed, testFailedThisOperationCycle, pendingDTC, confirmedDTC and
testFailedSinceLastClear are set at once. testFailed is reset by the next motion that reaches its end without the
event; the motion back after a trap or a block does not count. confirmedDTC and testFailedSinceLastClear remain
set until the codes are cleared. pendingDTC remains set until the end of an operation cycle in which the test
passed. A reset starts a new operation cycle. The codes survive it, as in an ECU's non-volatile memory."""


def rig_page() -> str:
    """Return the text of the page."""
    return page(
        "Rig files",
        _INTRO,
        "## The file",
        key_table(RigTable),
        "## The database",
        _DATABASE,
        "## A wired signal",
        key_table(MappingTable),
        "## `[inputs]`: what the gate receives",
        "`left_duty` is required. Without `right_duty` the right motor coasts, which `rig check` notes: map "
        "both to one signal, or take a vehicle with one drive (`drives = 1`). Without a direction signal the "
        "sign of the duty is the direction, and a duty of 0 brakes; with one, the sign does not count. Without "
        "`latch_release` the latch opens while a motor is driven open. The inputs from `obstacle_angle` on are "
        "those of a test bench: from its first frame on, such an input replaces the value of vehicle and "
        "scenario.",
        _quantities(BUS_INPUTS),
        "## `[outputs]`: what the gate sends",
        "A plain name such as `left_current` means the reading of a sensor. True values always have the prefix "
        "`true_` (`true_left_current`), even if no sensor measures them. So names keep their meaning when a "
        "sensor is added. A rig with an old name without the prefix is rejected, and the message gives the new "
        "name.",
        _quantities(BUS_OUTPUTS),
        "## `[messages.NAME]`",
        key_table(MessageTable),
        "## `checksum = {…}` of a message",
        _CHECKSUM,
        key_table(ChecksumTable),
        _MAKERS,
        "## `counter = {…}` of a message",
        _COUNTER,
        key_table(CounterTable),
        "## `state_machine` of a message",
        "AUTOSAR's E2E state machine. With the defaults no frame with an error is accepted.",
        key_table(StateMachineTable),
        "## `[requests.open]`, `[requests.close]`, `[requests.stop]`",
        "With an ECU on a bus (`--ecu bus`) a scenario's requests and its precondition press these buttons. A "
        "button is a signal that the bench sends cyclically along with the gate's messages, with the counter and "
        "the protection of its message. Before and after a press the signal has its value `rest`. The reference "
        "ECU reads these buttons, too.",
        key_table(ButtonTable),
        "## `[reset]`",
        "How an ECU on a bus is reset. Before each scenario these steps are done in this order: the signal, the "
        "ECUReset, the command, the condition `ready`. Without `ready` the bench waits for the ECU's first "
        "command. If a step does not succeed, the scenario is inconclusive.",
        "The request `reset` in the middle of a scenario uses only one of them: the signal; without a signal, the "
        "ECUReset; without either, the program. In real time the scenario continues while the program runs; on "
        "the other clocks model time stands still meanwhile.",
        key_table(ResetTable),
        _ECU_RESET,
        "## `[inject.fault]`, `[inject.babbling]`, `[inject.request]`, `[inject.signal]`",
        _INJECT,
        *(part for what, record in ORDERS.items() for part in (f"### `[inject.{what}]`", key_table(record))),
        "## `[diagnostics]`",
        _DIAGNOSTICS,
        key_table(DiagnosticsTable),
        "## The reference ECU's trouble codes",
        _ECU,
        table(("code", "number", "meaning"), map(_trouble_code, TROUBLE_CODES.values())),
        _STATUS,
    )


def _trouble_code(each: EcuDtc) -> Iterable[str]:
    return code(each.code), f"0x{number_of(each.code)[0]:06X}", each.meaning


def _quantities(signals: Mapping[str, Signal]) -> str:
    heads = ("quantity", "unit", "range", "values", "meaning")
    return table(heads, (_quantity(name, each) for name, each in signals.items()))


def _quantity(name: str, signal: Signal) -> Iterable[str]:
    values = ", ".join(f"{place} `{label}`" for place, label in enumerate(signal.values))
    span = "" if signal.values else f"{number(signal.low)} to {number(signal.high)}"
    return code(name), signal.unit, span, values, signal.meaning

"""docs/rig.md: every key of a rig file. Keys and ranges are the checker's answers; meanings stand here."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from liftgate_hil.codec.checksum import PROFILES
from liftgate_hil.config.diagnostics import KEYS
from liftgate_hil.config.driver import BUTTON, RESET
from liftgate_hil.config.inject import ORDERS
from liftgate_hil.config.protection_tables import CHECKSUM, COUNTER
from liftgate_hil.config.rig import load_rig
from liftgate_hil.diagnostics.trouble_code import number_of
from liftgate_hil.ecu.trouble_codes import TROUBLE_CODES, TroubleCode
from liftgate_hil.signals import BUS_INPUTS, BUS_OUTPUTS
from liftgate_plant.signals import Signal
from tools.docs.checker import UNKNOWN, WRONG, a_range, allowed, keys_of
from tools.docs.markdown import code, number, page, table
from tools.docs.schema import key_table

_INTRO = """\
A rig file is TOML: it says which signal of which database carries which quantity, for `--rig`, a scenario's
`rig` and `liftgate_hil.Gate(rig=…)`. [`liftgate.toml`](../configs/rigs/liftgate.toml) is the default;
`liftgate-hil init` copies it. Whoever sends a message, gate or ECU, packs and checks it by the same file.

A quantity is wired by `quantity = "MESSAGE.SIGNAL"`, or by a table where theirs differs from ours."""

_TOP = {
    "dbc": ("required", "the CAN database, beside the rig file or a shipped one (`liftgate.dbc`)"),
    "bitrate": (
        "500000",
        "of the bus: what it is opened with, and of what the bus load is a share",
    ),
    "inputs": ("", "table: what the gate receives, below"),
    "outputs": ("", "table: what the gate sends, below"),
    "messages": ("", "a table for each message: cycle, time-out and protection, below"),
    "requests": ("", "a table for each button: how the driver asks an ECU on a bus, below"),
    "reset": ("", "table: how an ECU on a bus is started anew, below"),
    "inject": ("", "tables: what a panel of the test bench injects while the emulator runs, below"),
    "diagnostics": ("", "table: how the ECU is asked for its trouble codes, below"),
}
_MAPPING = {
    "signal": ("required", "MESSAGE.SIGNAL of the database"),
    "unit": ("the database's", "what scale · physical value + offset is in"),
    "scale": (
        "1",
        "without `unit`: quantity = scale · physical value + offset, whatever the database says",
    ),
    "offset": ("0", "see `scale`"),
    "values": ("", "of an enumeration: a number or a label of theirs for each name of ours"),
    "saturates": ("false", "an output stays at the ends of the signal's range beyond it"),
}
MESSAGE = {
    "cycle_ms": ("the database's `GenMsgCycleTime`", "how often it is sent"),
    "timeout_cycles": ("3", "a command that does not come for so many cycles is stale"),
    "counter": ("none", "the signal that counts frames, up by one from 0; or a table, below"),
    "checksum": ("none", "the signal with the checksum; or a table with the parameters of a maker's own, below"),
    "checksum_kind": ("crc8-sae-j1850", "over the identifier and the payload without the checksum"),
    "protection": ("simple", "`simple` is counter and checksum as above; the others are AUTOSAR's profiles"),
    "data_id": ("required by profiles 1 and 5", "of the message"),
    "data_id_list": ("required by profile 2", "the data ID for each value of the counter"),
    "data_id_mode": ("both", "of profile 1: which bytes of the data ID the CRC takes in"),
    "data_id_nibble": ("none", "with `data_id_mode = \"nibble\"`: the signal with the data ID's nibble"),
    "max_delta_counter": ("1", "the largest step of the counter that is tolerated; 1: no frame may be lost"),
    "sync_counter": ("0", "frames after a wrong sequence that are not used yet"),
    "state_machine": ("", "table: when data are used, below"),
}  # fmt: skip
STATES = {
    "window": ("1", "frames over which the state is judged"),
    **{
        f"min_ok_{state}": ("1", f"sound frames in the window that it takes in the state {state.upper()}")
        for state in ("init", "valid", "invalid")
    },
    **{
        f"max_error_{state}": ("0", f"wrong frames in the window that are borne in the state {state.upper()}")
        for state in ("init", "valid", "invalid")
    },
}  # fmt: skip
_OTHERS = ("data_id", "data_id_list", "nothing")
_OWN = "a signal of the message"
_OWN_OR_TABLE = f"{_OWN}, or a table"
# Where the checker's words are about the one file that it was asked with.
_ANYWAY = {
    "signal": "MESSAGE.SIGNAL",
    "unit": "one of the quantity's kind: `mA` for a current",
    "saturates": "true or false",
    "counter": _OWN_OR_TABLE,
    "checksum": _OWN_OR_TABLE,
    "data_id_nibble": _OWN,
    "dbc": "a DBC, ARXML, KCD or SYM file",
    **dict.fromkeys(
        (key for key in STATES if key != "window"), "a whole number from 0 to `window`"
    ),
}

_CHECKSUM = """\
A cyclic redundancy check by the parameters of the Rocksoft model (R. N. Williams, 1993), as the Catalogue of
parametrised CRC algorithms (G. Cook) lists them; all of it of up to 64 bits is checked against its check
values. The named kinds stay: `checksum = "Checksum"` with `checksum_kind`.

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

`covers` lists what goes in, byte by byte in that order. `"payload"` is all bytes of the frame but those that
the checksum fills. `"payload 1 to 7"` are these bytes, both ends in, the first of the frame being 0; `"payload
7 to 1"` the other way round, `"payload 3"` one. Bits of the checksum in a byte that goes in count as 0.
`"identifier"` is the frame's, two bytes, of an extended one four; `"counter"` the counter's value, in as many
bytes as its signal needs; `"data_id"` the data ID, in as many bytes as the largest one needs. Byte 0 of these
is the lowest and goes in first; `"identifier 1 to 0"` puts the higher one first, `"data_id 0 to 1"` takes two
bytes whatever the value. The checksum's byte order is its signal's. `rig check` prints what that comes to."""

_MAKERS = """\
Of what open DBC projects know of makers these can be said so: Volkswagen MQB and MEB (0x2F, `covers =
["payload", "data_id"]`, a list of 16 data IDs by the counter), FCA Giorgio and Rivian (0x1D, another
`final_xor` for each message), Chrysler and Nissan (0x1D, `start` and `final_xor` 0xFF), Hyundai's LKAS11 (0x1D,
`start` 0x22, `final_xor` 0xDF) and Hyundai CAN FD (0x1021 of 16 bits, `covers = ["payload", "identifier"]`,
`final_xor` by the length). Subaru and Tesla have the named `sum8`. Sums and exclusive ors other than `sum8` and
`xor8` are no cyclic checks and cannot be said: Toyota (a sum with the length), Honda and PSA (sums of half
bytes), Hyundai's sums without the identifier, Volkswagen PQ, Ford. Such a message is left without `checksum`:
it is taken unchecked, and sent with that signal's start value."""

_COUNTER = """\
A counter of its own width, start and step. Frames between two of its values are counted as lost; a value that
it never has, as `counter`."""

_INJECT = """\
Messages by which a panel of CANoe, BUSMASTER or SavvyCAN, or a script, breaks something, presses a button of
`[requests]` or sets a signal of the restbus while the gate runs. A frame in which all signals of one table stand
is an order; ours are pages of the multiplexed `BenchInject` (0x6E4). What the labels of the database's value
tables say is what counts: another message, key or signal to choose from is another label.

An order acts from the next tick on; in real time within a few milliseconds, as it is read beside the loop. A
fault is the same as a scenario's, on top of which it is put, later ones on top of earlier ones. Ordered again
with another value it begins anew; the same order again changes nothing. To end it takes its kind and place,
whatever the value. Up to 32 are there at a time. A signal's message is sent from its first value on, with the
start values of its other signals. A request presses the rig's button; `reset` restarts the ECU as in the middle
of a scenario. Each order is told and stands in the summary (`injected`); one that is wrong is told and counted,
and changes nothing. Before a scenario's time 0 nobody listens, and on the free clock nobody is there to send."""

_DIAGNOSTICS = """\
Where a scenario expects a trouble code (`[[expect]] dtc`), the bench's tester asks the ECU under test for its
codes: UDS (ISO 14229-1) over ISO-TP (ISO 15765-2) with normal addressing and classic frames, on every clock in
model time, beside the frames that the gate sends. Its requests are ClearDiagnosticInformation of all groups (`14
FF FF FF`) until that is answered, then ReadDTCInformation by status mask (`19 02`), one at a time; after a
negative response it asks again a cycle later. Apart from the ECUReset of `[reset]` no other request is made: codes
must be readable in the default session. What is read so late is known so late: a window (`within_s`) is to leave
room for a `cycle_ms`. Identifiers may be those that cars use for diagnostics (0x7E0 to 0x7EF), which no message of
the gate may have; none of them may carry quantities of this rig. `Gate.read_dtcs` and `Gate.clear_dtcs` make the
same two requests, each once."""

_ECU_RESET = """\
`uds` needs `[diagnostics]` and the extra `uds`. `hardReset` is the request `11 01`, whose positive response is
`51 01`; `keyOffOnReset` is `11 02`, `softReset` `11 03`. It is made in the session that the ECU is in, without
security access. Before a scenario it is made again after each `[diagnostics] timeout_ms` without a response, as
the ECU may still be starting, until `timeout_s`; in the middle of a scenario it is made once, when what the
tester asked before is answered. After "response pending" (NRC 0x78) the tester waits 5 s more; after "busy,
repeat request" (0x21) it asks again a `cycle_ms` later; any other negative response is final. What comes within
0.1 s of the positive response is taken neither for the ECU's first command nor for what `ready` waits for, as
the ECU may still be on its way down; one that takes longer needs a `ready` that tells. An ECUReset in the
middle of a scenario that is refused or not answered makes the scenario's expectations inconclusive."""

_ECU = """\
With `[diagnostics]` the reference ECU answers such requests, and any other tester's: sessions default and extended
(`10 01`, `10 03`), hard reset (`11 01`), clear all codes or one (`14`), count and read them by status mask (`19
01`, `19 02`), tester present (`3E 00`). All else is refused as the standard says. Its codes are those of SAE J2012
with the failure type, in manufacturers' ranges:"""

_STATUS = """\
An event fails its test: testFailed, testFailedThisOperationCycle, pendingDTC, confirmedDTC and
testFailedSinceLastClear are set at once. testFailed goes with the next motion that comes to its end without that
event; a motion back after it does not count. confirmedDTC and testFailedSinceLastClear stay until codes are
cleared, pendingDTC until an operation cycle in which the test passed is over. A reset begins an operation cycle;
the codes outlast it, as they do in an ECU's non-volatile memory."""


def rig_page() -> str:
    """The page."""
    where = "messages.DriveCommand"
    by_profile = {profile: _answers(profile) for profile in PROFILES}
    answers: dict[str, str] = {}
    for each in by_profile.values():
        # A profile has no key that is another's: there it allows nothing.
        answers |= {key: said for key, said in each.items() if said not in _OTHERS}
    step = f"{where}.max_delta_counter"
    answers[step] = "; ".join(f"{each[step]} ({name})" for name, each in by_profile.items())
    return page(
        "Rig files",
        _INTRO,
        "## The file",
        _table(answers, "", _TOP),
        "## A wired signal",
        _table(answers, "inputs.left_duty", _MAPPING),
        "## `[inputs]`: what the gate receives",
        "`left_duty` is required. Without a direction the duty's sign is the direction; without `latch_release` "
        "the latch opens while a motor is driven open. All but the command are a test bench's: from its first "
        "frame on it replaces what vehicle and scenario say.",
        _quantities(BUS_INPUTS),
        "## `[outputs]`: what the gate sends",
        "What a sensor makes of a quantity has its plain name (`left_current`), what is so always the prefix "
        "`true_` (`true_left_current`), also where no sensor gives it: a sensor that is added changes no name's "
        "meaning. A rig with a name of before is refused with the name that it is now.",
        _quantities(BUS_OUTPUTS),
        "## `[messages.NAME]`",
        _table(answers, where, MESSAGE),
        "## `checksum = {…}` of a message",
        _CHECKSUM,
        key_table(CHECKSUM),
        _MAKERS,
        "## `counter = {…}` of a message",
        _COUNTER,
        key_table(COUNTER),
        "## `state_machine` of a message",
        "AUTOSAR's E2E state machine. Its defaults let no frame with an error through.",
        _table(answers, f"{where}.state_machine", STATES),
        "## `[requests.open]`, `[requests.close]`, `[requests.stop]`",
        "With an ECU on a bus (`--ecu bus`) a scenario's requests and its precondition press these buttons: "
        "signals that the bench sends beside the gate's, cyclically, with the counter and the protection of their "
        "message. They rest before and after. The reference ECU listens to them, too.",
        key_table(BUTTON),
        "## `[reset]`",
        "What goes before each scenario with an ECU on a bus, in this order: the signal, the ECUReset, the "
        "command, the condition. Without `ready` the ECU's first command is waited for. Whatever does not come "
        "makes the scenario inconclusive. The request `reset` in the middle of a scenario is the signal alone; "
        "without one, the ECUReset alone; without either, the program, which runs while the scenario goes on.",
        key_table(RESET),
        _ECU_RESET,
        "## `[inject.fault]`, `[inject.babbling]`, `[inject.request]`, `[inject.signal]`",
        _INJECT,
        *(
            part
            for what, keys in ORDERS.items()
            for part in (f"### `[inject.{what}]`", key_table(keys))
        ),
        "## `[diagnostics]`",
        _DIAGNOSTICS,
        key_table(KEYS),
        "## The reference ECU's trouble codes",
        _ECU,
        table(("code", "number", "meaning"), map(_trouble_code, TROUBLE_CODES.values())),
        _STATUS,
    )


def _answers(protection: str) -> dict[str, str]:
    """What the checker says to a rig in which all is wrong but the names."""
    command: dict[str, Any] = dict.fromkeys(MESSAGE, WRONG) | {"protection": protection}
    command |= {"state_machine": dict.fromkeys(STATES, WRONG) | {UNKNOWN: 1}, UNKNOWN: 1}
    wire = {"signal": "DriveCommand.LeftDuty", "scale": WRONG, "offset": WRONG, "values": 1}
    answers = allowed(
        load_rig,
        {
            "dbc": "liftgate.dbc",
            "bitrate": WRONG,
            UNKNOWN: 1,
            "inputs": {"left_duty": wire | {UNKNOWN: 1}},
            "messages": {"DriveCommand": command},
        },
    )
    simple = {"DriveCommand": {"protection": WRONG, "checksum_kind": WRONG}}
    wrong = allowed(load_rig, {"dbc": "liftgate.dbc", "messages": simple})
    return {**answers, **wrong}


def _table(answers: Mapping[str, str], prefix: str, told: Mapping[str, tuple[str, str]]) -> str:
    """The keys of a table, as the checker lists them."""
    return table(("key", "allowed", "default", "meaning"), _rows(answers, prefix, told))


def _rows(
    answers: Mapping[str, str], prefix: str, told: Mapping[str, tuple[str, str]]
) -> Iterator[tuple[str, ...]]:
    for key in keys_of(answers, prefix):
        default, meaning = told[key]
        answer = answers.get(f"{prefix}.{key}" if prefix else key, "")
        yield code(key), _ANYWAY.get(key) or a_range(answer), default, meaning


def _trouble_code(each: TroubleCode) -> Iterable[str]:
    return code(each.code), f"0x{number_of(each.code)[0]:06X}", each.meaning


def _quantities(signals: Mapping[str, Signal]) -> str:
    heads = ("quantity", "unit", "range", "values", "meaning")
    return table(heads, (_quantity(name, each) for name, each in signals.items()))


def _quantity(name: str, signal: Signal) -> Iterable[str]:
    values = ", ".join(f"{place} `{label}`" for place, label in enumerate(signal.values))
    span = "" if signal.values else f"{number(signal.low)} to {number(signal.high)}"
    return code(name), signal.unit, span, values, signal.meaning

"""Check of a rig: its mapped messages, and whether the rig fits a vehicle and a rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from liftgate_hil.config.rig import read_rig
from liftgate_hil.config.rig_fit import check_fit, notes_on_fit
from liftgate_hil.config.rig_table import MappedMessage, asked_by, injected_by, mapped_messages, protected_besides
from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.diagnostics.tester import Diagnostics
from liftgate_hil.ecu.reference import lacking_feedback
from liftgate_hil.errors import ConfigError
from liftgate_hil.plan.request import RigCheckRequest
from liftgate_hil.plan.setup import vehicle_from


# fmt: off
@dataclass(frozen=True)
class RigReport(DescribedResult):
    """Result of a rig check: what the rig maps, and whether it fits a vehicle and a rate."""

    file: Annotated[Path, Shown("path of the rig")]
    database: Annotated[Path, Shown("path of the database")]
    vehicle: Annotated[str, Shown("name of the vehicle for which it was checked")]
    rate: Annotated[float, Shown("tick rate for which it was checked [Hz]")]
    messages: Annotated[list[MappedMessage], Shown("messages that carry quantities, those that the gate receives "
        "first")]
    restbus_protection: Annotated[Mapping[str, str], Shown("protection of messages that carry no quantity", keys={
        "MESSAGE": "counter and checksum, in words"})]
    requests: Annotated[Mapping[str, str], Shown("how requests reach an ECU on a bus", keys={"ACTION": "signal "
        "and values, in words"})]
    inject: Annotated[Mapping[str, str], Shown("orders that a test bench gives by a message", keys={
        "ORDER": "message and signals of the order, in words"})]
    diagnostics: Annotated[Diagnostics | None, Shown("the tester's settings, see `[diagnostics]` of the "
        "[rig file](rig.md); null: none", parts={
            "request": "identifier of requests, as a number; bit 31 is set if it has 29 bits",
            "response": "identifier of responses, alike",
            "padding": "byte that fills frames; -1: none",
            "period": "from one reading to the next [s]",
            "patience": "longest wait for a response [s]",
            "status_mask": "status bits by which a code counts as reported",
            "clears": "whether all codes are cleared before the first reading",
            "names": "messages in the database: [request, response]",
        })]
    notes: Annotated[Sequence[str], Shown("sentences: what does not fit well")]
    issues: Annotated[Sequence[str], Shown("what is wrong, one text each; empty: the rig fits")]


# fmt: on
def checked_rig(path: Path, request: RigCheckRequest) -> RigReport:
    """Check the rig of a file; return its mapping and all issues. Raises ConfigError for the vehicle."""
    vehicle = vehicle_from(request.vehicle, request.settings, draw=request.draw, ideal=request.ideal)
    rig, issues = read_rig(path)
    # What follows from a mapping that could not be read is no news beside the reason.
    notes = list(rig.notes)
    if not issues.lines:
        notes += notes_on_fit(rig, vehicle, request.rate)
        if lacking := ", ".join(lacking_feedback(rig, vehicle.drives)):  # which another ECU may not need
            notes.append(f"{rig.source}: the reference ECU cannot use this rig, as it lacks {lacking}; yours may")
        if not rig.driver.buttons:
            text = "a scenario's requests and the page's driver buttons cannot reach an ECU on the bus"
            notes.append(f"{rig.source}: {text}: [requests] maps them, see docs/rig.md")
    try:
        check_fit(rig, vehicle, request.rate)
    except ConfigError as error:
        issues.take(error.issues)
    return RigReport(
        path,
        rig.database,
        str(request.vehicle),
        request.rate,
        mapped_messages(rig),
        protected_besides(rig),
        asked_by(rig),
        injected_by(rig),
        rig.diagnostics,
        notes,
        issues.lines,
    )

"""Report on a run or a demo, as `--json` prints it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from liftgate_hil.described_result import DescribedResult, Shown
from liftgate_hil.drive.result import Result as RunResult
from liftgate_hil.report.pinch import PinchEvent
from liftgate_hil.report.provenance import Provenance


# fmt: off
@dataclass(frozen=True)
class RunReport(DescribedResult):
    """JSON report on a run: its result, what ended it, and its provenance."""

    result: Annotated[RunResult, Shown("its result", is_flat=True)]
    stop_reason: Annotated[str, Shown("signal that stopped the run: `SIGINT`, `SIGTERM`; else `given up`, if the "
        "bench ended it early (exit code 3), or `duration`")]
    provenance: Annotated[Provenance, Shown("see Provenance")]


@dataclass(frozen=True)
class DemoReport(RunReport):
    """JSON report on a demo: the report on its run, and its pinch event."""

    pinch: Annotated[PinchEvent | None, Shown("`demo` only: the contact with the largest pinch force; null: "
        "nothing was pinched")]

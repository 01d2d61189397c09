"""Job: a run as it is requested, and what surrounds it in this process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from liftgate_hil.config.choices import WireChoice
from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.loop.listener import Listener
from liftgate_hil.plan.request import RunRequest

PRIVATE_BUS = "virtual"  # name in recordings of a bus that is in this process alone


@dataclass(frozen=True)
class Job:
    """A run as it is requested, in plain values where possible, so that another process can be given it."""

    request: RunRequest
    wire: WireChoice | None = None  # None: the ECU is in this process, and so is the bus
    trace: int = 0  # keep every n-th row; 0: none
    ecu_elsewhere: Any = None  # the ECU on the bus, if this program runs it in another process
    mutant: str = ""  # name of a mutant of the reference ECU, see ecu/mutants.py
    is_isolated: bool = False  # run in a process of its own, as C libraries always are
    listener: Listener = field(default_factory=Listener)
    attachable_as: int | None = None  # process that clients may attach to; None: they may not
    exit_codes: Mapping[str, int] = field(default_factory=dict)  # of the command, by verdict; told to clients
    gives_up_late: bool = False  # end a run at the first lateness after which its verdicts are not all known
    is_summarized: bool = False  # keep trace summaries for pictures of the expectations

    @property
    def is_episode(self) -> bool:
        """Whether it runs in machine code, with the ECU in this process and waiting for nobody."""
        return self.request.clock == "free" and self.request.ecu != ON_A_BUS

    def asking(self, **values: Any) -> Job:
        """Return the job with other values in its request."""
        return replace(self, request=self.request.replaced(**values))

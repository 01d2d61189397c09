"""Observers that supervise a run beside its loop: ECU resets, orders of a test bench, attached clients."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from liftgate_hil.operate.loop_target import LoopTarget
from liftgate_hil.operate.operator import Operator
from liftgate_hil.operate.orders import Orders
from liftgate_hil.stimuli.restbus import BENCH, OPERATOR

if TYPE_CHECKING:
    from liftgate_hil.loop.listener import Listener
    from liftgate_hil.loop.observers import Observer
    from liftgate_hil.loop.python_loop import PeerNode
    from liftgate_hil.loop.rings import Memory
    from liftgate_hil.loop.statistics import Summary
    from liftgate_hil.operate.attachment.description import Description
    from liftgate_hil.operate.attachment.server import Server
    from liftgate_hil.operate.ecu_reset import Restarts
    from liftgate_hil.operate.further_recording import FurtherRecording
    from liftgate_hil.plan.plan import Plan
    from liftgate_hil.stimuli.stimulus_plan import StimulusPlan


@dataclass(frozen=True)
class Observers:
    """Observers of one run, one of each kind; None: the run has none of that kind."""

    restarts: Restarts | None = None  # reset the ECU by a program
    orders: Orders | None = None  # executes orders of the rig's test bench
    server: Server | None = None  # serves attached clients
    operator: Operator | None = None  # executes clients' commands, over the bench's orders

    def in_order(self) -> list[Observer]:
        """Return the observers in the order in which they are called."""
        return [each for each in (self.orders, self.restarts, self.server) if each is not None]

    @property
    def injected(self) -> set[str]:
        """Kinds of the faults that the test bench or an attached client has injected during the run."""
        return {kind for each in (self.orders, self.operator) if each for kind in each.kinds}

    def let_in(self, about: Description, memory: Memory, recording: FurtherRecording) -> None:
        """Let clients attach, if the run has a server; `recording` is the one that they can start."""
        if self.server is not None and self.operator is not None:
            self.operator.recording = recording
            self.server.open(about, memory, self.operator)

    def end(self) -> None:
        """Report the last value of an operator's series of settings, while recordings can still take the mark."""
        if self.operator is not None:
            self.operator.end_series()

    def note(self, summary: Summary) -> None:
        """Enter clients' commands and recordings, and the test bench's injections, in the run's summary."""
        if self.operator is not None:
            further = self.operator.recording
            summary.recordings = [*summary.recordings, *([] if further is None else further.files)]
            summary.commands = self.operator.count
            summary.commanded = self.operator.done
        if self.orders is not None:
            summary.injections = self.orders.count
            summary.injected = self.orders.done
            summary.injections_refused = self.orders.refused


def observers_of(
    plan: Plan,
    stimuli: StimulusPlan,
    is_real: bool,
    listener: Listener,
    peers: Sequence[PeerNode],
    restarts: Restarts | None,
    server: Server | None,
) -> Observers:
    """Build a run's observers; those for a test bench and an operator only if its plan lets faults be injected.

    They change the run's `stimuli`. `is_real`: the bus is not a virtual one; `peers` are ECUs in this process, to
    which an operator's requests go; `restarts` and `server` are among the observers if they are given.
    """
    setup, rig = plan.setup, plan.rig
    if not plan.opening.slots:
        return Observers(restarts, server=server)
    restart = None if restarts is None else restarts.restart
    target = LoopTarget(stimuli, setup, rig, plan.opening.signals, is_real, restart)
    orders = operator = None
    if rig.orders:
        orders = Orders(rig, target.layer(BENCH), listener.say)
    if server is not None:
        edge = setup.vehicle.gate.length

        def ask(action: str) -> bool:
            return any(peer.request(action) for peer in peers)

        operator = Operator(rig, target.layer(OPERATOR), edge, ask=ask)
    return Observers(restarts, orders, server, operator)

"""Who looks after a run beside its loop: restarts the ECU, reads a test bench's orders, hears who is attached."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from liftgate_hil.injection.operator import Operator
from liftgate_hil.injection.orders import Orders
from liftgate_hil.injection.slot_target import SlotTarget
from liftgate_hil.staging import opening_of
from liftgate_hil.stimuli.restbus import BENCH, OPERATOR

if TYPE_CHECKING:
    from liftgate_hil.attachment.description import Description
    from liftgate_hil.attachment.host import Host
    from liftgate_hil.config.rig import Rig
    from liftgate_hil.listener import Listener
    from liftgate_hil.loop.python_loop import Peer
    from liftgate_hil.loop.recorder import Attendant
    from liftgate_hil.loop.rings import Memory
    from liftgate_hil.loop.statistics import Summary
    from liftgate_hil.restarting import Restarts
    from liftgate_hil.session import Setup
    from liftgate_hil.stimuli.scene import Scene


@dataclass(frozen=True)
class Attendance:
    """Of one run; None: there is none of these."""

    restarts: Restarts | None = None  # of the ECU, by a program
    orders: Orders | None = None  # of the rig's test bench
    host: Host | None = None  # of those who are attached
    operator: Operator | None = None  # what they command, over what the bench says

    def attendants(self) -> list[Attendant]:
        """In the order in which they look."""
        return [each for each in (self.orders, self.restarts, self.host) if each is not None]

    @property
    def injected(self) -> set[str]:
        """The kinds of faults that were injected while it ran."""
        return {kind for each in (self.orders, self.operator) if each for kind in each.kinds}

    def let_in(
        self,
        about: Description,
        memory: Memory,
        hold: Callable[[Mapping[str, float]], bool],
        stack: contextlib.ExitStack,
    ) -> None:
        """Let others attach, where they may, until the stack is left; `hold` see Operator."""
        if self.host is None or self.operator is None:
            return
        stack.callback(self.host.close)
        self.operator.hold = hold
        self.host.open(about, memory, self.operator)

    def note(self, summary: Summary) -> None:
        """What was done, among the figures of the run."""
        if self.operator is not None:
            summary.commands = self.operator.count
            summary.commanded = self.operator.done
        if self.orders is not None:
            summary.injections = self.orders.count
            summary.injected = self.orders.done
            summary.injections_refused = self.orders.refused


def attendance_of(
    scene: Scene,
    setup: Setup,
    rig: Rig,
    is_real: bool,
    listener: Listener,
    peers: Sequence[Peer] = (),
    restarts: Restarts | None = None,
    host: Host | None = None,
) -> Attendance:
    """As far as a scene is open to them, on a bus that `is_real` or in this process; `peers` are the ECU in it."""
    if not len(scene.slots.letters):
        return Attendance(restarts, host=host)
    signals = opening_of(rig, host is not None).signals
    restart = None if restarts is None else restarts.restart
    target = SlotTarget(scene, setup, rig, signals, is_real, restart)
    orders = operator = None
    if rig.orders:
        orders = Orders(rig, target.layer(BENCH), listener.say)
    if host is not None:
        edge = setup.vehicle.gate.length

        def ask(action: str) -> bool:
            return any(peer.request(action) for peer in peers)

        operator = Operator(rig, target.layer(OPERATOR), edge, ask=ask)
    return Attendance(restarts, orders, host, operator)

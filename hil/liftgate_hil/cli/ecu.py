"""An ECU alone, on any bus: drives the gate as a car's control unit would, by the messages on the bus.

The reference ECU obeys the scenario's [[request]] tables (default: the demo's), or the requests of --request.
"""

from __future__ import annotations

import argparse
import signal

from liftgate_hil.cli.command import Call, add_flags, add_printed
from liftgate_hil.cli.stopping import StopSignals
from liftgate_hil.ecu.names import ON_A_BUS
from liftgate_hil.errors import ConfigError, EcuError
from liftgate_hil.isolate.supervisor import supervise
from liftgate_hil.plan.request import EcuRequest

_EXIT_CODES = frozenset((0, 1, 2, 128 + signal.SIGINT, 128 + signal.SIGTERM))  # exit codes of this command


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `ecu` to its parser."""
    add_flags(parser, EcuRequest)
    add_printed(parser)


def run(call: Call) -> int:
    """Run the subcommand `ecu` (the reference ECU, or another, alone on a bus) and return its exit code."""
    from liftgate_hil.ecu.find import is_foreign, is_library

    request = call.request(EcuRequest)
    if is_foreign(request.ecu) and call.owns_process:
        supervise(allowed=_EXIT_CODES)
    stop = StopSignals()
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.drive.ecu_alone import drive_alone

    if request.ecu == ON_A_BUS:
        raise ConfigError("`ecu` bus: allowed here: reference, LIBRARY, MODULE:CLASS")
    if is_library(request.ecu):
        stop.end_machine_code()
    try:
        drive_alone(request, Teller(call.is_quiet), stop)
    except EcuError as error:
        raise stop.failure(str(error)) from error
    return 0

"""Makes the machine code of all loops ahead of time, and says where it is: for container images and CI caches.

Whatever is there already is left as it is. It is made for this processor, this version and its numba.
"""

from __future__ import annotations

import argparse
import sys

from liftgate_hil.cli.command import Call, add_printed
from liftgate_hil.errors import LiftgateError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the flags of `compile` to its parser."""
    add_printed(parser)


def run(call: Call) -> int:
    """Run the subcommand `compile` (fill the cache with all machine code) and return its exit code."""
    import liftgate_compiler as compiler
    from liftgate_hil.cli.machine_code import CompilationListener, compile_loops, compile_others, function_of
    from liftgate_hil.cli.stopping import StopSignals
    from liftgate_hil.cli.terminal.teller import Teller
    from liftgate_hil.drive.compilation import ENTRY_POINTS, reporting_compilation

    stopped, teller = StopSignals(), Teller(call.is_quiet)
    listener = CompilationListener(teller, sum(not compiler.is_cached(function_of(name)) for name in ENTRY_POINTS))
    if not compiler.enabled():
        raise LiftgateError("the compiler is switched off (LIFTGATE_COMPILE=0); allowed: LIFTGATE_COMPILE not set")
    try:
        with reporting_compilation(listener, stopped), compiler.sharing():
            compile_loops(listener, stopped)
            compile_others()
    except compiler.GivenUpError:
        return stopped.exit_code
    finally:
        teller.clear()
    if stopped():
        return stopped.exit_code
    files = list(compiler.cache_folder().rglob("*.code"))
    for name, (what, _) in ENTRY_POINTS.items():
        if not compiler.is_cached(function_of(name)):  # files of other versions may be there
            raise LiftgateError(f"machine code of the {what} could not be saved; see the message above")
    if not call.is_quiet:
        size = sum(file.stat().st_size for file in files) / 1e6
        print(f"{compiler.cache_folder()}: {len(files)} files, {size:.1f} MB", file=sys.stdout)
    return 0

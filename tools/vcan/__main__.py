"""Run a command on a machine that has a real SocketCAN vcan0: python -m tools.vcan [options] -- COMMAND …

If this kernel has SocketCAN, COMMAND runs here, in a network namespace of its own with a fresh vcan0 (no root
needed where user namespaces are allowed). If it has not (a container or sandbox kernel without AF_CAN), COMMAND
runs in a User-Mode Linux machine: an ordinary process, no root, no KVM, about 2 s to boot.

In the machine
  * the host's files are at the same paths (so the virtual environment and the repository work unchanged), the
    environment and the current directory are the caller's;
  * writes to the current directory, and to each --out FOLDER, go to the host; writes anywhere else (/tmp, the
    home folder, ...) work but are lost at power-off;
  * COMMAND runs as root, on one CPU, with stdin empty and no network but lo and the CAN interfaces. These carry
    CAN FD too. can-raw, -bcm, -gw, -j1939, vcan, vxcan and slcan are loaded.

Exit status: COMMAND's own (128 + N if signal N ended it, 127 not found, 126 not runnable); 124 --timeout passed;
125 no such machine is available, or it failed, and a line says why.
"""

import argparse
import signal
import sys
from pathlib import Path

from tools.vcan.install import install
from tools.vcan.native import native_prefix, run_native
from tools.vcan.process import OWN_FAILURE, UnavailableError, say
from tools.vcan.uml import Machine, run_uml


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """Return the parsed command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.vcan", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--install",
        action="store_true",
        help="first install what is missing, then try the machine with COMMAND, or with none",
    )
    parser.add_argument("--timeout", type=float, metavar="S", help="end COMMAND after S seconds; default: never")
    parser.add_argument(
        "--out",
        dest="outs",
        action="append",
        default=[],
        type=lambda text: Path(text).resolve(),
        metavar="FOLDER",
        help="a further folder whose writes go to the host (repeatable)",
    )
    parser.add_argument(
        "--iface",
        dest="interfaces",
        action="append",
        metavar="NAME",
        help="vcan interfaces to make (repeatable); default: vcan0",
    )
    parser.add_argument("--mode", choices=("auto", "native", "uml"), default="auto")
    parser.add_argument(
        "--mem",
        type=int,
        default=1024,
        metavar="MIB",
        help="most memory of the User-Mode Linux machine; default: 1024",
    )
    parser.add_argument("--verbose", "-v", action="store_true", help="show the machine's console and times")
    parser.add_argument("command", nargs=argparse.REMAINDER, metavar="COMMAND ...")
    args = parser.parse_args(arguments)
    if args.command[:1] == ["--"]:
        del args.command[0]
    if not args.command:
        if not args.install:
            parser.error("no COMMAND")
        args.command = ["true"]
    args.interfaces = args.interfaces or ["vcan0"]
    return args


def run(args: argparse.Namespace) -> int:
    """Run the command in the first way that is available; return its exit status. Raises UnavailableError."""
    reasons = []
    if args.install:
        install(args.interfaces, args.mode)
    if args.mode != "uml":
        try:
            prefix = native_prefix(args.interfaces)
            return run_native(prefix, args.command, args.timeout, args.verbose)
        except UnavailableError as error:
            reasons.append(f"native: {error}")
    if args.mode != "native":
        for folder in args.outs:
            folder.mkdir(parents=True, exist_ok=True)
        machine = Machine(args.interfaces, args.outs, args.mem, args.timeout, args.verbose)
        try:
            return run_uml(machine, args.command)
        except UnavailableError as error:
            reasons.append(f"User-Mode Linux: {error}")
    raise UnavailableError("; ".join(reasons))


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit status."""
    args = parse(arguments)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        return run(args)
    except UnavailableError as error:
        say(f"no machine with a vcan: {error}")
        return OWN_FAILURE
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    except BrokenPipeError:
        return 128 + signal.SIGPIPE


if __name__ == "__main__":
    sys.exit(main())

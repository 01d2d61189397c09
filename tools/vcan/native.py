"""Native way to run a command with a vcan0: in a network namespace of its own, on a kernel with SocketCAN."""

import os
import socket
import subprocess
from pathlib import Path

from tools.vcan.places import environment
from tools.vcan.process import UnavailableError, end_session, exit_status, say, say_timeout, spawn, still_running

# Script for root of a new network namespace: brings up lo and the interfaces in $1, then becomes the command.
# An MTU of 72 lets a vcan carry CAN FD; it carries classic frames as before.
_SETUP = (
    'ip link set lo up; for i in $1; do ip link add dev "$i" mtu 72 type vcan && '
    'ip link set "$i" up || exit 125; done; shift; exec "$@"'
)


def native_prefix(interfaces: list[str]) -> list[str]:
    """Return the words to put before a command, which give it a namespace with those interfaces.

    There are none if no namespace can be made but the interfaces are up already. Raises UnavailableError.
    """
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except (OSError, AttributeError) as error:
        raise UnavailableError(f"this kernel has no AF_CAN ({error})") from error
    # Real root stays in the first user namespace and so keeps its capabilities, which SCHED_FIFO needs. Any other
    # user becomes root of a new one.
    ways = [["unshare", "--net"]] if os.geteuid() == 0 else []
    ways.append(["unshare", "--user", "--map-root-user", "--net"])
    why = ""
    for way in ways:
        prefix = [*way, "--", "sh", "-c", _SETUP, "vcan", " ".join(interfaces)]
        try:
            trial = subprocess.run(
                [*prefix, "true"], capture_output=True, text=True, check=False, env=environment(os.environ)
            )
        except FileNotFoundError as error:
            raise UnavailableError("no unshare (apt-get install util-linux)") from error
        if trial.returncode == 0:
            return prefix
        why = (trial.stderr.strip().splitlines() or ["no message"])[-1]
    if all(_is_up(interface) for interface in interfaces):  # made by a user with the privilege
        return []
    raise UnavailableError(f"AF_CAN is here, but no vcan could be made: {why}")


def run_native(prefix: list[str], command: list[str], timeout: float | None, verbose: bool = False) -> int:
    """Run the command with that prefix for at most `timeout` seconds; return its exit status."""
    if verbose:
        way = " ".join(prefix[: prefix.index("--")]) if prefix else "the interfaces that are here"
        say(f"native: {way}")
    child = spawn(prefix + command, env=environment(os.environ))
    try:
        timed_out = still_running(child, timeout or float("inf"))
    finally:
        returncode = end_session(child)
    return say_timeout(timeout or 0.0) if timed_out else exit_status(returncode)


def _is_up(interface: str) -> bool:
    try:
        flags = Path("/sys/class/net", interface, "flags").read_text()
    except OSError:
        return False
    return bool(int(flags, 16) & 1)

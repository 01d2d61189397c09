"""Checks of CAN interfaces, of adapters that python-can detects, and of serial ports."""

from __future__ import annotations

import contextlib
import grp
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from liftgate_hil.doctor.check import Check, judged, number, read

_CAN = "280"  # ARPHRD_CAN
_UP = 0x1  # IFF_UP
_FD_MTU = 72
_QUEUE = 10  # frames; the gate sends up to six at once
PATIENCE = 10.0  # s that drivers have to answer
_END_S = 1.0  # s for the search's process to be gone after it was killed
VCAN = "sudo modprobe vcan; sudo ip link add vcan0 type vcan; sudo ip link set vcan0 up"

# Runs in a process of its own, as a driver may hang or crash. Drivers log what they miss; only the answer counts.
_ASK = """
import json, logging, warnings
logging.disable(logging.CRITICAL)
warnings.simplefilter("ignore")
from liftgate_hil.config.can_libraries import can
found = can.detect_available_configs()
print("\\n" + json.dumps([[str(each["interface"]), str(each["channel"])] for each in found]))
"""


def open_can() -> None:
    """Create a CAN socket and close it, to check that this is possible. Raises OSError."""
    if not hasattr(socket, "AF_CAN"):
        raise OSError("Python was built without SocketCAN")
    socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()


def socketcan(attempt: Callable[[], None] = open_can) -> Check:
    """Check whether the kernel supports CAN; `attempt` opens a CAN socket, and raises OSError if it cannot."""
    try:
        attempt()
    except OSError as error:
        found = f"not available ({error.strerror or error}): --bus socketcan: cannot be used"
        mend = "sudo modprobe can_raw; if there is no such module, boot a kernel with CONFIG_CAN"
        return judged("SocketCAN", found, mend)
    return Check("SocketCAN", "ok", "available")


def interfaces(root: Path, details: Callable[[str], str]) -> list[Check]:
    """Check each CAN interface; `details` returns the output of `ip -details -json link show NAME` for a name."""
    paths = sorted((root / "sys/class/net").glob("*/type"))
    names = [path.parent.name for path in paths if read(path.parent, "type") == _CAN]
    if not names:
        mend = f"plug an adapter in; without hardware: {VCAN}; or use --bus udp_multicast:239.74.163.2"
        return [judged("CAN interfaces", "none", mend)]
    return [_interface(root, name, link_of(details(name))) for name in names]


def link_of(text: str) -> Mapping[str, object]:
    """Return an interface's kind, bitrate [bit/s] and state (None: not stated) from `ip`'s JSON; {}: no link."""
    try:
        link = json.loads(text)[0]["linkinfo"]
        data = link.get("info_data", {})
        bitrate = data.get("bittiming", {}).get("bitrate")
        return {"kind": link["info_kind"], "bitrate": bitrate, "state": data.get("state")}
    except (ValueError, LookupError, TypeError, AttributeError):
        return {}


def _interface(root: Path, name: str, link: Mapping[str, object]) -> Check:
    folder = root / "sys/class/net" / name
    is_real = link.get("kind", "vcan" if name.startswith("vcan") else "can") == "can"
    is_up = bool(int(read(folder, "flags") or "0", 16) & _UP)
    queue = number(read(folder, "tx_queue_len"), 0)
    words = ["" if is_real else "virtual", "up" if is_up else "down"]
    if link.get("bitrate"):
        words.append(f"{link['bitrate']} bit/s")
    if link.get("state"):
        words.append(str(link["state"]).lower())
    can_fd = number(read(folder, "mtu"), 16) >= _FD_MTU
    words += ["CAN FD" if can_fd else "classic CAN", f"queue of {queue} frames"]
    mend = ""
    if not is_up:
        how = " type can bitrate 500000" if is_real else ""
        mend = f"sudo ip link set {name} up{how}"
    elif is_real and read(folder, "carrier") == "0":
        words.append("not running (bus-off?)")
        mend = (
            f"check wiring, termination and bit rate, then sudo ip link set {name} down; "
            f"sudo ip link set {name} up type can bitrate 500000 restart-ms 100"
        )
    elif is_real and queue < _QUEUE:
        mend = f"sudo ip link set {name} txqueuelen 100"
    return judged(name, ", ".join(filter(None, words)), mend)


def ask_ip(name: str) -> str:
    """Return iproute2's JSON description of an interface; "" where iproute2 is missing or does not answer."""
    with contextlib.suppress(OSError, subprocess.SubprocessError):
        return subprocess.run(
            ["ip", "-details", "-json", "link", "show", name],
            capture_output=True, text=True, timeout=2.0, check=False,
        ).stdout  # fmt: skip
    return ""


class Detection:
    """Search for adapters by python-can, started at once in a process of its own, as it takes seconds."""

    def __init__(self, command: Sequence[str] = (sys.executable, "-P", "-c", _ASK)) -> None:
        self._child: subprocess.Popen[str] | None = None
        with contextlib.suppress(OSError):  # reported by `wait`
            self._child = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL, text=True, start_new_session=True,
            )  # fmt: skip

    def wait(self, patience: float = PATIENCE) -> Check:
        """Wait for the search, at most `patience` [s], and return a check with the adapters found."""
        if self._child is None:
            return _undetected("python-can's search could not be started")
        try:
            out, _ = self._child.communicate(timeout=patience)
        except subprocess.TimeoutExpired:
            return _undetected(f"a driver did not answer within {patience:g} s")
        try:
            found = json.loads(out.splitlines()[-1])
        except (ValueError, IndexError):
            return _undetected(f"python-can's search failed (exit code {self._child.returncode})")
        return adapters(found)

    def close(self) -> None:
        """End the search, whether it has finished or not."""
        if self._child is not None:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._child.pid, signal.SIGKILL)  # with what a driver has started
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._child.communicate(timeout=_END_S)


def _undetected(why: str) -> Check:
    mend = "unplug adapters one by one, or name yours: liftgate-hil --bus INTERFACE:CHANNEL"
    return judged("adapters", why, mend)


def adapters(found: Sequence[Sequence[str]]) -> Check:
    """Return a check that lists the adapters python-can found, except serial, SocketCAN and virtual ones."""
    with_hardware = [
        f"{interface}:{channel}"
        for interface, channel in found
        if interface not in ("virtual", "udp_multicast", "serial", "socketcan")
    ]
    return Check("adapters", "ok", f"found by python-can's drivers: {', '.join(with_hardware) or 'none'}")


def list_ports() -> list[Any]:
    """Return the serial ports that pyserial finds."""
    from serial.tools.list_ports import comports

    return list(comports())


def serial_ports(ports: Sequence[Any], user: str) -> Check:
    """Check the serial ports, and whether this user may open those that a device is plugged into."""
    if not ports:
        return Check("serial ports", "ok", "none")
    words, shut = [], []
    for port in sorted(ports, key=lambda each: (each.vid is None, each.device)):
        plugged = port.vid is not None
        words.append(f"{port.device} ({port.description})" if plugged else port.device)
        if not os.access(port.device, os.R_OK | os.W_OK):
            words[-1] += " not accessible to this user"
            if plugged:
                shut.append(port.device)
    group = _group_of(shut[0]) if shut else ""
    mend = f"sudo usermod -aG {group} {user}, then log in again" if shut else ""
    return judged("serial ports", ", ".join(words), mend)


def _group_of(device: str) -> str:
    """Return the name of the group that may open a device; "dialout" where it cannot be determined."""
    with contextlib.suppress(OSError, KeyError):
        return grp.getgrgid(Path(device).stat().st_gid).gr_name
    return "dialout"

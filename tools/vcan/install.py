"""Installation of packages for a vcan0 machine on Debian and Ubuntu: as root, or unpacked into our cache."""

import os
import subprocess
import tempfile
from pathlib import Path

from tools.vcan.native import native_prefix
from tools.vcan.places import find_program, unpacked_root
from tools.vcan.process import UnavailableError, say

PROGRAMS = {"user-mode-linux": "linux.uml", "iproute2": "ip", "can-utils": "candump"}
APT_LIMIT = 600.0  # s


def missing_packages(interfaces: list[str], mode: str) -> list[str]:
    """Return the missing ones of the packages that the available way of running needs."""
    packages = list(PROGRAMS)
    if mode != "uml":
        try:
            native_prefix(interfaces)
            packages = ["can-utils"]
        except UnavailableError:
            pass
    return [package for package in packages if find_program(PROGRAMS[package]) is None]


def install(interfaces: list[str], mode: str) -> None:
    """Install the missing packages. Raises UnavailableError."""
    missing = missing_packages(interfaces, mode)
    if not missing:
        return
    names = " ".join(missing)
    if find_program("apt-get") is None:
        raise UnavailableError(f"missing: {names}; there is no apt-get, install them by hand")
    say(f"installing {names} …")
    reasons = []
    for way in (_with_root, _unpack):
        try:
            way(missing)
        except UnavailableError as error:
            reasons.append(str(error))
        else:
            return
    raise UnavailableError(f"missing: {names}; {'; '.join(reasons)}")


def _with_root(packages: list[str]) -> None:
    root = []
    if os.geteuid() != 0:
        root = ["sudo", "--non-interactive"]
        if find_program("sudo") is None or not _succeeds([*root, "true"]):
            raise UnavailableError("neither root nor a sudo without password")
    apt = [*root, "env", "DEBIAN_FRONTEND=noninteractive", "apt-get"]
    command = [*apt, "install", "--yes", "--no-install-recommends", *packages]
    if not _succeeds(command):
        _succeeds([*apt, "update"])
        _output(command)


def _unpack(packages: list[str]) -> None:
    root = unpacked_root()
    root.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="packages.", dir=root) as folder:
        apt = ["apt-get"]
        try:
            names = _with_dependencies(apt, packages)
        except UnavailableError:  # no package lists on this machine: fetch our own
            for name in ("lists/partial", "archives/partial"):
                (Path(folder) / name).mkdir(parents=True)
            apt += ["-o", f"Dir::State::Lists={folder}/lists", "-o", f"Dir::Cache={folder}"]
            _output([*apt, "update"])
            names = _with_dependencies(apt, packages)
        _output([*apt, "download", *names], folder)
        for package in sorted(Path(folder).glob("*.deb")):
            _output(["dpkg", "-x", str(package), str(root)])


def _with_dependencies(apt: list[str], packages: list[str]) -> list[str]:
    """Return those of the packages and their dependencies that apt would newly install.

    Installed packages that apt would upgrade are good enough as they are.
    """
    command = [*apt, "install", "--simulate", "--no-install-recommends", *packages]
    lines = [line.split() for line in _output(command).splitlines() if line.startswith("Inst ")]
    return [words[1] for words in lines if not words[2].startswith("[")]


def _output(command: list[str], folder: str | None = None) -> str:
    """Run a command and return its output. Raises UnavailableError with the last line of its messages."""
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=APT_LIMIT,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UnavailableError(f"{command[0]}: {error}") from error
    if done.returncode:
        words = next((word for word in command if "apt-get" in word), command[0])
        last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        raise UnavailableError(f"{words} failed: {last}")
    return done.stdout


def _succeeds(command: list[str]) -> bool:
    try:
        _output(command)
    except UnavailableError:
        return False
    return True

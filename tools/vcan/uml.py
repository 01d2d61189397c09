"""User-Mode Linux way to run a command with a vcan0: the host's side of a machine whose kernel has SocketCAN.

The machine is an ordinary process, without root and KVM, and boots in about 2 s. Its process 1 is guest.py.
"""

import contextlib
import itertools
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from tools.vcan.places import environment, find_program
from tools.vcan.process import OWN_FAILURE, UnavailableError, end_session, say, say_timeout, spawn, still_running

BOOT_LIMIT = 180.0  # s; usually 2 s, on a busy host more
POWER_OFF_LIMIT = 30.0  # s


@dataclass
class Machine:
    """Settings of a machine; `timeout` [s] is that of the command."""

    interfaces: list[str]
    outs: list[Path] = field(default_factory=list)  # further folders whose writes go to the host
    memory_mib: int = 512
    timeout: float | None = None
    verbose: bool = False


def find_uml() -> tuple[str, Path]:
    """Return the machine's kernel and its folder of modules. Raises UnavailableError."""
    kernel = find_program("linux.uml")
    packages = {"user-mode-linux": kernel, "iproute2": find_program("ip")}
    missing = " ".join(package for package, program in packages.items() if program is None)
    if kernel is None or missing:
        raise UnavailableError(
            f"missing: {missing}; install with: python -m tools.vcan --install, or "
            f"apt-get install --no-install-recommends {missing}"
        )
    done = subprocess.run([kernel, "--version"], capture_output=True, text=True, check=False)
    version = done.stdout.strip()
    # The package's own layout, which is the same if the package was only unpacked.
    modules = Path(kernel).resolve().parents[1] / "lib/uml/modules" / version
    if not (modules / "modules.dep").is_file():
        raise UnavailableError(f"no modules for {kernel} {version} in {modules}")
    return kernel, modules


def run_uml(machine: Machine, command: list[str]) -> int:
    """Run the command in a machine; return its exit status. Raises UnavailableError."""
    kernel, modules = find_uml()
    if Path("/") in (Path.cwd(), *machine.outs):
        raise UnavailableError("the root folder cannot be one to write to; cd to another")
    memory = _memory_folder(machine.memory_mib)
    # The job is under /tmp, with plain names, because the kernel's command line splits at blanks.
    with tempfile.TemporaryDirectory(prefix="vcan.", dir="/tmp") as folder:
        job = Path(folder)
        _write_job(job, machine, command, modules)
        return _boot(job, machine, kernel, memory)


def _memory_folder(mebibytes: int) -> str:
    """Return a folder for the machine's memory file: with enough room, and not mounted noexec.

    Docker mounts /dev/shm noexec. The file is sparse, and deleted as soon as it is open. Raises UnavailableError.
    """
    for folder in ("/dev/shm", os.environ.get("TMPDIR"), "/tmp"):
        if folder and Path(folder).is_dir() and os.access(folder, os.W_OK):
            status = os.statvfs(folder)
            room = status.f_bavail * status.f_frsize >= mebibytes << 20
            if room and not status.f_flag & os.ST_NOEXEC:
                return folder
    raise UnavailableError(
        f"none of /dev/shm, $TMPDIR, /tmp is mounted exec and has {mebibytes} MiB free; see --mem"
    )


def _write_job(job: Path, machine: Machine, command: list[str], modules: Path) -> None:
    cwd = Path.cwd()
    wanted = {
        "command": command,
        "cwd": str(cwd),
        "environment": environment(os.environ),
        "outs": [str(folder) for folder in (cwd, *machine.outs)],
        "interfaces": machine.interfaces,
        "modules": str(modules),
        "timeout": machine.timeout,
    }
    (job / "job.json").write_text(json.dumps(wanted))
    shutil.copyfile(Path(__file__).with_name("guest.py"), job / "guest.py")
    (job / "python").symlink_to(Path(sys.executable).resolve())
    for name in ("stdout", "stderr", "status"):
        (job / name).touch()


def _boot(job: Path, machine: Machine, kernel: str, memory: str) -> int:
    # Each system call in the machine switches between two processes of the host. That takes about 10 µs on one CPU
    # and up to 100 µs across two, so both are kept on one.
    cpus = sorted(os.sched_getaffinity(0))
    started = time.time()
    with (job / "console").open("wb") as console:
        child = spawn(
            [
                kernel, f"mem={machine.memory_mib}M", "rootfstype=hostfs", "rootflags=/", "ro",
                f"uml_dir={job}/uml", "con=null", "con0=null,fd:1", f"init={job}/python",
                "--", "-ISB", f"{job}/guest.py", str(job),
            ],
            cpu=cpus[os.getpid() % len(cpus)],
            stdout=console,
            stderr=console,
            env={**os.environ, "TMPDIR": memory} | with_whole_registers(job),
        )  # fmt: skip
    hung = _wait(child, job, machine.timeout)
    text = (job / "console").read_text(errors="replace")
    status: dict[str, Any] = {}
    for line in (job / "status").read_text().splitlines():
        status |= json.loads(line)
    if machine.verbose:
        sys.stderr.write(text)
    if "exit_status" not in status:
        if not machine.verbose:
            sys.stderr.write(text[-4000:])
        say(
            "the machine hung and was ended"
            if hung
            else "the machine ended before the command did; its console is above"
        )
        return OWN_FAILURE
    if machine.verbose:
        times = started, status["begin"], status["end"], time.time()
        boot, ran, off = (after - before for before, after in itertools.pairwise(times))
        say(f"boot {boot:.2f} s, command {ran:.2f} s, power-off {off:.2f} s")
    if status["timed_out"]:
        return say_timeout(machine.timeout or 0.0)
    return int(status["exit_status"])


def with_whole_registers(job: Path) -> dict[str, str]:
    """Return the environment in which the kernel boots with AMX, too (xstate.c); empty without a compiler."""
    source, library = Path(__file__).with_name("xstate.c"), job / "xstate.so"
    compiler = shutil.which("cc")
    if compiler is None:
        return {}
    command = [compiler, "-O2", "-shared", "-fPIC", "-o", str(library), str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        say(f"{source.name} does not compile, so the kernel does not boot with AMX: {done.stderr.strip()[-200:]}")
        return {}
    earlier = os.environ.get("LD_PRELOAD")
    return {"LD_PRELOAD": f"{library}:{earlier}" if earlier else str(library)}


def _wait(child: subprocess.Popen[bytes], job: Path, timeout: float | None) -> bool:
    """Pass the command's output on until the machine ends; return whether the machine had to be ended.

    The guest itself enforces the timeout; the limits here are for a machine that hangs.
    """
    begun = False
    deadline = time.monotonic() + BOOT_LIMIT
    hung = True
    with _outputs(job) as outputs:
        try:
            while hung and time.monotonic() < deadline:
                hung = still_running(child, 0.05)
                _hand_on(outputs)
                if not begun and (job / "status").stat().st_size:
                    begun = True
                    deadline = time.monotonic() + (timeout or float("inf")) + POWER_OFF_LIMIT
        finally:
            end_session(child)
        _hand_on(outputs)
    return hung


@contextlib.contextmanager
def _outputs(job: Path) -> Iterator[list[tuple[BinaryIO, int]]]:
    with (job / "stdout").open("rb") as out, (job / "stderr").open("rb") as error:
        yield [(out, 1), (error, 2)]


def _hand_on(outputs: list[tuple[BinaryIO, int]]) -> None:
    for source, sink in outputs:
        while data := source.read(1 << 16):
            while data:
                data = data[os.write(sink, data) :]

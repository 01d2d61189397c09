"""Process 1 of a User-Mode Linux machine: it sets the machine up, runs the command, writes its status, powers off.

The module runs as a file of its own, copied into the job's folder: it imports the standard library only, and
nothing else of this project.
"""

import ctypes
import json
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

MODULES = (
    *("can-raw", "can-bcm", "can-gw", "can-j1939", "vcan", "vxcan", "slcan", "overlay"),
    "sch_prio",  # priority queues, so that one can be full for some senders only
)
MS_MOVE, FINIT_MODULE, POWER_OFF = 0x2000, 313, 0x4321FEDC
WORK = Path("/dev/.vcan")  # on devtmpfs, the only writable place at first
NOT_FOUND, NOT_RUNNABLE = 127, 126

_libc = ctypes.CDLL(None, use_errno=True)


def main(job_folder: str) -> None:
    """Run the job and power off the machine; this function never returns."""
    try:
        _run_job(job_folder)
    except BaseException as error:  # goes to the console, which the host shows
        print(f"vcan: setting the machine up failed: {error!r}", flush=True)
    os.sync()
    _libc.reboot(POWER_OFF)


def _run_job(job_folder: str) -> None:
    WORK.mkdir()
    mount("tmpfs", WORK, "tmpfs")
    for name in ("job", "upper", "work", "root"):
        (WORK / name).mkdir()
    mount("none", WORK / "job", "hostfs", data=job_folder)
    job = json.loads((WORK / "job/job.json").read_text())
    out, err, status = (
        os.open(WORK / "job" / name, os.O_WRONLY | os.O_APPEND) for name in ("stdout", "stderr", "status")
    )
    load_modules(Path(job["modules"]))
    change_root(job["outs"])
    modules = Path("/lib/modules", os.uname().release)  # for modprobe, where it is installed
    if not modules.exists():
        modules.parent.mkdir(parents=True, exist_ok=True)
        modules.symlink_to(job["modules"])
    socket.sethostname("vcan")
    os.environ.update(job["environment"])
    make_interfaces(job["interfaces"])

    def leave(**values: Any) -> None:  # the host reads these lines
        os.write(status, json.dumps(values).encode() + b"\n")
        os.fsync(status)

    leave(begin=time.time())
    result = run_command(job, out, err)
    os.sync()
    leave(**result)


def mount(source: str, target: Path, kind: str = "", flags: int = 0, data: str = "") -> None:
    """Mount a file system by its system call. Raises OSError."""
    _check(
        _libc.mount(
            source.encode(),
            os.fsencode(target),
            kind.encode() or None,
            ctypes.c_ulong(flags),
            data.encode() or None,
        ),
        f"mount {kind} on {target}",
    )


def load_modules(folder: Path) -> None:
    """Load MODULES, after the modules that they depend on; kmod is not needed. Raises OSError."""
    paths = {}
    for line in (folder / "modules.dep").read_text().splitlines():
        path, _, needs = line.partition(":")
        paths[Path(path).stem] = [*reversed(needs.split()), path]
    loaded = set()
    for name in MODULES:
        if name not in paths:
            print(f"vcan: this kernel has no module {name}", flush=True)
        for path in paths.get(name, []):
            if path not in loaded:
                loaded.add(path)
                with (folder / path).open("rb") as file:
                    _check(_libc.syscall(FINIT_MODULE, file.fileno(), b"", 0), f"load {path}")


def change_root(outs: list[str]) -> None:
    """Change the root: the host's files, and above them a tmpfs that takes all writes except those to `outs`."""
    root = WORK / "root"
    layers = f"lowerdir=/,upperdir={WORK}/upper,workdir={WORK}/work"
    mount("overlay", root, "overlay", data=layers)
    for kind, place in (
        ("proc", "proc"),
        ("sysfs", "sys"),
        ("devtmpfs", "dev"),
        ("devpts", "dev/pts"),
        ("tmpfs", "dev/shm"),
    ):
        (root / place).mkdir(parents=True, exist_ok=True)
        mount(kind, root / place, kind)
    for folder in outs:
        place = root / folder.lstrip("/")
        place.mkdir(parents=True, exist_ok=True)
        mount("none", place, "hostfs", data=folder)
    os.chdir(root)
    mount(".", Path("/"), flags=MS_MOVE)
    os.chroot(".")


def make_interfaces(names: list[str]) -> None:
    """Bring up lo, and make the vcans; their MTU of 72 is for CAN FD and carries classic frames too."""
    ip = ["ip", "link"]
    subprocess.run([*ip, "set", "lo", "up"], check=True)
    for name in names:
        subprocess.run([*ip, "add", "dev", name, "mtu", "72", "type", "vcan"], check=True)
        subprocess.run([*ip, "set", name, "up"], check=True)


def run_command(job: dict[str, Any], out: int, err: int) -> dict[str, Any]:
    """Run the job's command until it ends or times out, end the processes that it left, and return its status."""
    timed_out = False
    try:
        child = subprocess.Popen(
            job["command"],
            cwd=job["cwd"],
            env=job["environment"],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            start_new_session=True,
        )
    except OSError as error:
        os.write(err, f"vcan: {job['command'][0]}: {error.strerror}\n".encode())
        status = NOT_FOUND if isinstance(error, FileNotFoundError) else NOT_RUNNABLE
        return {"exit_status": status, "timed_out": False, "end": time.time()}

    def on_alarm(*_: object) -> None:
        nonlocal timed_out
        timed_out = True
        os.kill(-1, signal.SIGKILL)  # all but process 1

    signal.signal(signal.SIGALRM, on_alarm)
    if job["timeout"]:
        signal.setitimer(signal.ITIMER_REAL, job["timeout"])
    while True:  # process 1 inherits and reaps orphans
        pid, state = os.wait()
        if pid == child.pid:
            break
    signal.setitimer(signal.ITIMER_REAL, 0)
    end = time.time()
    returncode = os.waitstatus_to_exitcode(state)
    os.kill(-1, signal.SIGKILL)
    status = 128 - returncode if returncode < 0 else returncode
    return {"exit_status": status, "timed_out": timed_out, "end": end}


def _check(result: int, what: str) -> None:
    if result != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"{what}: {os.strerror(number)}")


if __name__ == "__main__":
    main(sys.argv[1])

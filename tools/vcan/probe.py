"""Probe of a machine's real-time features: python -m tools.vcan -- python -m tools.vcan.probe

It prints one line per system feature: whether it works, and the cost of a call, including ctypes.
"""

import ctypes
import mmap
import os
import socket
import statistics
import struct
import time
from collections.abc import Callable
from multiprocessing import shared_memory
from pathlib import Path

SO_RXQ_OVFL, SO_TIMESTAMPNS, SO_RCVBUFFORCE = 40, 35, 33
MCL_CURRENT, MCL_FUTURE = 1, 2
TIMER_ABSTIME = 1
MSG_DONTWAIT = 0x40
CALLS = 5000
PERIOD_NS = 1_000_000

libc = ctypes.CDLL(None, use_errno=True)


class Timespec(ctypes.Structure):
    """C structure timespec."""

    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


def cost_us(call: Callable[[], object], calls: int = CALLS) -> str:
    """Return the time of a call [µs] as text: the median over batches, which ignores other processes' time."""
    batch = calls // 20
    times = []
    for _ in range(20):
        begin = time.perf_counter_ns()
        for _ in range(batch):
            call()
        times.append((time.perf_counter_ns() - begin) / batch / 1000.0)
    return f"{statistics.median(times):.1f} µs"


def checked(result: int) -> int:
    """Return the result of a C function. Raises OSError if it is negative."""
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))
    return result


def can_socket(*options: tuple[int, int]) -> socket.socket:
    """Return a raw CAN socket on vcan0, with options of SOL_SOCKET as (option, value)."""
    raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    for option, value in options:
        raw.setsockopt(socket.SOL_SOCKET, option, value)
    raw.bind(("vcan0",))
    return raw


def fifo() -> str:
    """Request FIFO scheduling with its reset on fork; return the policy as text."""
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(50))
    policy = os.sched_getscheduler(0)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return f"policy {policy:#x}"


def lock_memory() -> str:
    """Lock all present and future memory with mlockall; return the amount that was locked, as text."""
    checked(libc.mlockall(MCL_CURRENT | MCL_FUTURE))
    status = Path("/proc/self/status").read_text().splitlines()
    checked(libc.munlockall())
    return next(line for line in status if line.startswith("VmLck"))


def lateness(scheduling: int, priority: int) -> str:
    """Return the lateness of clock_nanosleep to absolute deadlines 1 ms apart, as text."""
    os.sched_setscheduler(0, scheduling, os.sched_param(priority))
    due = time.monotonic_ns() + PERIOD_NS
    late = []
    for _ in range(3000):
        when = Timespec(due // 10**9, due % 10**9)
        libc.clock_nanosleep(time.CLOCK_MONOTONIC, TIMER_ABSTIME, ctypes.byref(when), None)
        late.append((time.monotonic_ns() - due) / 1000.0)
        due += PERIOD_NS
        if late[-1] > 1000.0:
            due = time.monotonic_ns() + PERIOD_NS
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    late.sort()
    marks = " ".join(f"p{p} {late[int(len(late) * p / 100)]:.0f}" for p in (1, 50, 90, 99))
    missed = sum(each > 1000.0 for each in late)
    return f"late {marks} max {late[-1]:.0f} µs, over 1 ms: {missed} of 3000"


def receive_empty() -> str:
    """Return the cost of polling as text: recvmmsg on a CAN_RAW socket without frames."""
    with can_socket() as raw:
        headers = ctypes.create_string_buffer(64 * 8)
        number = raw.fileno()

        def call() -> None:
            if libc.recvmmsg(number, headers, 8, MSG_DONTWAIT, None) != -1:
                raise OSError("something came")

        call()
        if (error := ctypes.get_errno()) != 11:
            raise OSError(error, os.strerror(error))
        return cost_us(call)


def send_frame() -> str:
    """Return the cost of sending one classic frame as text; only the loopback listens."""
    frame = struct.pack("=IB3x8s", 0x123, 8, bytes(8))
    with can_socket() as raw:
        return cost_us(lambda: raw.send(frame))


def ancillary() -> str:
    """Return the drop counter (SO_RXQ_OVFL) after an overflow and a frame's stamp (SO_TIMESTAMPNS), as text."""
    frame = struct.pack("=IB3x8s", 0x123, 8, bytes(8))
    with can_socket((SO_RXQ_OVFL, 1), (SO_TIMESTAMPNS, 1)) as listener, can_socket() as sender:
        for _ in range(3000):
            sender.send(frame)
        held = 0
        listener.setblocking(False)
        try:
            while True:
                listener.recvmsg(16, 256)
                held += 1
        except BlockingIOError:
            pass
        sender.send(frame)
        _, extra, _, _ = listener.recvmsg(16, 256)
        found = {kind: data for _, kind, data in extra}
        lost = struct.unpack("=I", found[SO_RXQ_OVFL])[0]
        seconds, nanoseconds = struct.unpack("=qq", found[SO_TIMESTAMPNS])
        age = time.time_ns() - seconds * 10**9 - nanoseconds
        size = listener.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        return f"{held} held of 3000 in {size} bytes, {lost} lost, time stamp {age / 1e3:.0f} µs old"


def larger_buffer() -> str:
    """Request a receive buffer beyond the limit with SO_RCVBUFFORCE; return its size as text."""
    with can_socket((SO_RCVBUFFORCE, 4_000_000)) as raw:
        return f"{raw.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)} bytes"


def memfd() -> str:
    """Write to anonymous memory that can be shared (memfd_create); return its size as text."""
    number = os.memfd_create("probe")
    os.ftruncate(number, 1 << 20)
    with mmap.mmap(number, 1 << 20) as memory:
        memory[0] = 1
    os.close(number)
    return "1 MiB"


def named_memory() -> str:
    """Write to shared memory under /dev/shm; return its size as text."""
    memory = shared_memory.SharedMemory(create=True, size=1 << 20)
    memory.buf[0] = 1
    memory.close()
    memory.unlink()
    return "1 MiB"


def read_clock() -> str:
    """Return the costs of the C library's clock_gettime (by vDSO or not), a system call and a no-op, as text."""
    when = Timespec()
    pointer = ctypes.byref(when)
    by_libc = cost_us(lambda: libc.clock_gettime(time.CLOCK_MONOTONIC, pointer))
    return f"{by_libc}, a getppid() {cost_us(os.getppid)}, a no-op {cost_us(int)}"


PROBES = {
    "SCHED_FIFO": fifo,
    "mlockall": lock_memory,
    "clock_gettime": read_clock,
    "clock_nanosleep, SCHED_OTHER": lambda: lateness(os.SCHED_OTHER, 0),
    "clock_nanosleep, SCHED_FIFO": lambda: lateness(os.SCHED_FIFO, 50),
    "recvmmsg, nothing there": receive_empty,
    "send to vcan0": send_frame,
    "SO_RXQ_OVFL, SO_TIMESTAMPNS": ancillary,
    "SO_RCVBUFFORCE": larger_buffer,
    "memfd_create": memfd,
    "/dev/shm": named_memory,
}


def main() -> None:
    """Run all probes in turn and print their results."""
    for name, probe in PROBES.items():
        try:
            result = probe()
        except (OSError, KeyError) as error:
            result = f"does not work: {error!r}"
        print(f"{name:30} {result}", flush=True)


if __name__ == "__main__":
    main()

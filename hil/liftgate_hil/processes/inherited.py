"""Descriptors that a child process is given."""

from __future__ import annotations

import os
import subprocess


def in_memory(content: bytes) -> int:
    """A descriptor from which the content is read, to be closed by the caller; unlike a pipe it never makes the
    writer wait.
    """
    descriptor = os.memfd_create("given", os.MFD_CLOEXEC)
    with open(descriptor, "wb", closefd=False) as stream:
        stream.write(content)
    os.lseek(descriptor, 0, os.SEEK_SET)
    return descriptor


def foreign_output() -> int:
    """Where foreign code's standard output goes: to stderr, since a program may read what this one prints."""
    try:
        os.fstat(2)
    except OSError:
        return subprocess.DEVNULL
    return 2

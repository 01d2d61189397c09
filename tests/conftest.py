"""What holds for all tests: as many processes as CPUs run them, so that no process needs threads of its own."""

from __future__ import annotations

import os
import signal

import pytest

# Before numpy is loaded. Matrices are small here, so that threads of the BLAS only wait for each other:
# identification takes 47 s of CPU with two of them, and 29 s with one.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

# python-can with all of its formats, before anything of ours loads it without asammdf.
import can  # noqa: E402, F401

# A shell starts what is to run in the background without Ctrl-C, and so would the programs under test be.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

pytest.register_assert_rewrite(
    "kills", "tests.hil.identify.many_seeds", "tests.hil.identify.pauses", "tests.system.kills"
)

"""ECU libraries in C, compiled for a test."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

import liftgate_hil.ecu

HEADERS = Path(liftgate_hil.ecu.__file__).parent
needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


def build(folder: Path, source: str, name: str = "ecu.so") -> Path:
    """Compile a C source text to a shared library, and return its path."""
    path = folder / f"{name}.c"
    path.write_text(source)
    command = ["cc", "-std=gnu99", "-O1", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC"]
    command += ["-fvisibility=hidden", f"-I{HEADERS}", "-o", str(folder / name), str(path)]
    result = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    return folder / name


_SOURCE = """
#include "liftgate_ecu.h"
#include <fcntl.h>
#include <signal.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
static int state;
volatile int *volatile nowhere;
void *liftgate_ecu_create(void) {{ {create} return &state; }}
void liftgate_ecu_destroy(void *ecu) {{ (void)ecu; {destroy} }}
void liftgate_ecu_request(void *ecu, int action) {{ (void)ecu; (void)action; {request} }}
int liftgate_ecu_step(void *ecu, int64_t now_ns, const struct liftgate_frame *in, int count,
                      struct liftgate_frame *out, int capacity)
{{
    (void)ecu, (void)now_ns, (void)in, (void)count, (void)out, (void)capacity;
    {step}
    return 0;
}}
"""


def source_of(create: str = "", destroy: str = "", request: str = "", step: str = "") -> str:
    """Return the source of an ECU that sends nothing and runs given code in its functions."""
    return _SOURCE.format(create=create, destroy=destroy, request=request, step=step)

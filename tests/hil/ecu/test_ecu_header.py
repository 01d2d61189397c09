"""The C header for ECU libraries: self-contained, in C and C++, with its documented layout."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from hil_support import text_file

import liftgate_hil.ecu

HEADER = Path(liftgate_hil.ecu.__file__).parent / "liftgate_ecu.h"
STRICT = ("-Wall", "-Wextra", "-Werror", "-pedantic")
DIALECTS = [("cc", "c99"), ("cc", "c11"), ("c++", "c++98"), ("c++", "c++17")]

LIBRARY = """
#include "liftgate_ecu.h"
#include "liftgate_ecu.h"
#include <stddef.h>
typedef char size_is_72[sizeof(struct liftgate_frame) == 72 ? 1 : -1];
typedef char data_is_at_6[offsetof(struct liftgate_frame, data) == 6 ? 1 : -1];
static int state;
void *liftgate_ecu_create(void) { return &state; }
void liftgate_ecu_destroy(void *ecu) { (void)ecu; }
void liftgate_ecu_request(void *ecu, int action) { *(int *)ecu = action == LIFTGATE_REQUEST_OPEN; }
int liftgate_ecu_step(void *ecu, int64_t now_ns, const struct liftgate_frame *in, int count,
                      struct liftgate_frame *out, int capacity)
{
    (void)ecu;
    if (now_ns > 0 && count > 0 && capacity > 0 && in[0].flags == LIFTGATE_FRAME_FD) {
        out[0] = in[0];
        return 1;
    }
    return 0;
}
"""


def compile_source(compiler: str, dialect: str, source: Path, *options: str) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}")
    command = [compiler, f"-std={dialect}", *STRICT, f"-I{HEADER.parent}", str(source), *options]
    result = subprocess.run(command, check=False, capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize(("compiler", "dialect"), DIALECTS)
def test_the_header_is_self_contained(tmp_path: Path, compiler: str, dialect: str) -> None:
    source = text_file(tmp_path / ("alone.c" if compiler == "cc" else "alone.cpp"), '#include "liftgate_ecu.h"\n')
    compile_source(compiler, dialect, source, "-fsyntax-only")


@pytest.mark.parametrize(("compiler", "dialect"), DIALECTS)
def test_a_library_with_the_header_exports_only_its_c_functions(
    tmp_path: Path, compiler: str, dialect: str
) -> None:
    if shutil.which("nm") is None:
        pytest.skip("no nm")
    source = text_file(
        tmp_path / ("library.c" if compiler == "cc" else "library.cpp"),
        LIBRARY + "int helper(void);\nint helper(void) { return state; }\n",
    )
    target = tmp_path / "library.so"
    options = ("-shared", "-fPIC", "-fvisibility=hidden", "-o", str(target))
    compile_source(compiler, dialect, source, *options)
    command = ["nm", "-D", "--defined-only", str(target)]
    listing = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert {line.split()[-1] for line in listing.splitlines()} == {
        f"liftgate_ecu_{name}" for name in ("create", "destroy", "request", "step")
    }

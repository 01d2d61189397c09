"""The C header agrees with the Python codec, stays within its buffers, and compiles as C++."""

from __future__ import annotations

import ctypes
import random
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from hil_support import CALM, text_file
from hypothesis import given
from hypothesis import strategies as st
from serial_lines import line_of, noisy_line

import liftgate_hil.transport
from liftgate_hil.transport.cobs import CobsDecoder, encode, stuff

HEADERS = Path(liftgate_hil.transport.__file__).parent

compiler = shutil.which("cc")
needs_compiler = pytest.mark.skipif(compiler is None, reason="no C compiler")
STRICT = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wsign-conversion", "-Wshadow", "-Werror")
COUNTERS = ("frames", "cut", "too_long", "too_short", "bad_crc", "bad_id")

LIBRARY = """
#include "liftgate_serial.h"
size_t encode(uint16_t id, const uint8_t *payload, size_t n, uint8_t *out, size_t size);
size_t decode(const uint8_t *line, size_t n, uint8_t *out, uint32_t *counters);
size_t encode(uint16_t id, const uint8_t *payload, size_t n, uint8_t *out, size_t size)
{
    return lgs_encode(id, payload, n, out, size);
}
/* Frames come out as id low, id high, length, payload. */
size_t decode(const uint8_t *line, size_t n, uint8_t *out, uint32_t *counters)
{
    static lgs_receiver receiver;
    lgs_frame frame;
    size_t used = 0u;
    size_t i;
    size_t k;
    lgs_init(&receiver);
    for (i = 0u; i < n; i++) {
        if (lgs_receive(&receiver, line[i], &frame) == LGS_FRAME) {
            out[used++] = (uint8_t)(frame.id & 0xFFu);
            out[used++] = (uint8_t)(frame.id >> 8);
            out[used++] = frame.length;
            for (k = 0u; k < frame.length; k++) {
                out[used++] = frame.data[k];
            }
        }
    }
    counters[0] = receiver.frames;
    counters[1] = receiver.cut;
    counters[2] = receiver.too_long;
    counters[3] = receiver.too_short;
    counters[4] = receiver.bad_crc;
    counters[5] = receiver.bad_id;
    return used;
}
"""

FUZZER = (
    LIBRARY
    + """
#include <stdio.h>
#include <stdlib.h>
static uint32_t state = 1u;
static uint32_t dice(uint32_t sides)
{
    state = state * 1664525u + 1013904223u;
    return (state >> 8) % sides;
}
/* Heap buffers of exactly the promised sizes, so that the sanitizer sees every byte too many. */
int main(void)
{
    lgs_receiver *receiver = calloc(1u, sizeof *receiver);
    lgs_frame *frame = malloc(sizeof *frame);
    uint32_t whole = 0u;
    uint32_t round_;
    for (round_ = 0u; round_ < 20000u; round_++) {
        const size_t n = dice(65u);
        uint8_t *payload = malloc(n + 1u);
        uint8_t *line = malloc(n + 6u);
        size_t size;
        size_t i;
        const uint32_t fault = dice(4u);
        for (i = 0u; i < n; i++) {
            payload[i] = (uint8_t)(dice(3u) == 0u ? 0u : dice(256u));
        }
        size = lgs_encode((uint16_t)dice(0x800u), payload, n, line, n + 6u);
        if ((size != n + 6u) || (lgs_encode(1u, payload, n, line, n + 5u) != 0u)) {
            return 1;
        }
        for (i = 0u; i < size; i++) {
            const uint8_t byte = (fault == 0u) ? (uint8_t)dice(256u)
                               : (fault == 1u) ? (uint8_t)(1u + dice(255u)) : line[i];
            whole += (uint32_t)(lgs_receive(receiver, byte, frame) == LGS_FRAME);
        }
        free(payload);
        free(line);
    }
    if ((whole != receiver->frames) || (whole < 5000u)) {
        return 2;
    }
    free(receiver);
    free(frame);
    return 0;
}
"""
)


def compile_c(source: str, target: Path, *flags: str) -> None:
    assert compiler is not None
    subprocess.run(
        [compiler, *STRICT, *flags, f"-I{HEADERS}", "-x", "c", "-", "-o", str(target)],
        input=source, text=True, check=True, timeout=120,
    )  # fmt: skip


@pytest.fixture(scope="module")
def header(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    target = tmp_path_factory.mktemp("header") / "header.so"
    compile_c(LIBRARY, target, "-std=c99", "-O2", "-shared", "-fPIC")
    library = ctypes.CDLL(str(target))
    library.encode.restype = library.decode.restype = ctypes.c_size_t
    library.encode.argtypes = [
        ctypes.c_uint16, ctypes.c_char_p, ctypes.c_size_t, ctypes.c_char_p, ctypes.c_size_t,
    ]  # fmt: skip
    return library


def c_encode(header: ctypes.CDLL, identifier: int, payload: bytes, room: int = 70) -> bytes:
    """Return the bytes of a frame encoded by the C header, none if it refuses the frame."""
    out = ctypes.create_string_buffer(room)
    size = header.encode(identifier, payload, len(payload), out, room)
    return out.raw[:size]


def c_decode(header: ctypes.CDLL, line: bytes) -> tuple[list[tuple[int, bytes]], dict[str, int]]:
    """Return the frames of a line decoded by the C header, and its counters by name."""
    out = ctypes.create_string_buffer(2 * len(line) + 100)
    counters = (ctypes.c_uint32 * 6)()
    used = header.decode(line, ctypes.c_size_t(len(line)), out, counters)
    data, got = out.raw[:used], []
    while data:
        got.append((int.from_bytes(data[:2], "little"), data[3 : 3 + data[2]]))
        data = data[3 + data[2] :]
    return got, dict(zip(COUNTERS, counters, strict=True))


def have_equal_counts(decoder: CobsDecoder, counters: dict[str, int]) -> bool:
    """Whether Python and the C header have counted the same bad frames by cause."""
    return tuple(decoder.counts) == tuple(counters[name] for name in COUNTERS[1:])


@needs_compiler
@pytest.mark.parametrize("fill", [bytes, lambda n: b"\xff" * n, random.Random(3).randbytes])
def test_c_and_python_agree_on_frames_of_every_size(header: ctypes.CDLL, fill: Callable[[int], bytes]):
    rows = [(31 * size & 0x7FF, fill(size)) for size in range(65)]
    for row in rows:
        assert c_encode(header, *row) == encode(*row)
    assert c_decode(header, line_of(rows))[0] == rows
    assert CobsDecoder().feed(b"".join(c_encode(header, *row) for row in rows)) == rows


@needs_compiler
@pytest.mark.parametrize("seed", range(20))
def test_c_and_python_agree_on_a_disturbed_line(header: ctypes.CDLL, seed: int):
    _, line = noisy_line(seed)
    decoder = CobsDecoder()
    got, counters = c_decode(header, line)
    assert got == decoder.feed(line)
    assert have_equal_counts(decoder, counters)
    assert counters["frames"] == len(got)


@needs_compiler
def test_c_and_python_agree_on_any_bytes(header: ctypes.CDLL):
    @CALM
    @given(st.binary(max_size=300) | st.binary(max_size=80).map(lambda raw: stuff(raw) + b"\0"))
    def agree(line: bytes) -> None:
        decoder = CobsDecoder()
        got, counters = c_decode(header, line)
        assert got == decoder.feed(line)
        assert have_equal_counts(decoder, counters)

    agree()


@needs_compiler
def test_the_c_header_refuses_invalid_identifiers_long_payloads_and_small_buffers(header: ctypes.CDLL):
    assert c_encode(header, 0x800, b"") == b""
    assert c_encode(header, 0, bytes(65), room=100) == b""
    assert c_encode(header, 0, bytes(8), room=13) == b""
    assert len(c_encode(header, 0, bytes(8), room=14)) == 14


@needs_compiler
def test_the_c_header_stays_within_its_buffers(tmp_path: Path):
    target = tmp_path / "fuzzer"
    compile_c(
        FUZZER, target, "-std=c99", "-g", "-O1", "-fsanitize=address,undefined",
        "-fno-sanitize-recover=all",
    )  # fmt: skip
    subprocess.run([str(target)], check=True, timeout=120)


@pytest.mark.skipif(shutil.which("c++") is None, reason="no C++ compiler")
def test_the_c_header_compiles_as_cpp(tmp_path: Path):
    source = text_file(
        tmp_path / "use.cpp",
        '#include "liftgate_serial.h"\nint main() { lgs_receiver r = {}; lgs_frame f;\n'
        "uint8_t line[LGS_MAX_ENCODED]; lgs_status last = LGS_PENDING;\n"
        "const size_t n = lgs_encode(7u, nullptr, 0u, line, sizeof line);\n"
        "for (size_t i = 0u; i < n; i++) { last = lgs_receive(&r, line[i], &f); }\n"
        "return last == LGS_FRAME && f.id == 7u ? 0 : 1; }\n",
    )
    target = tmp_path / "use"
    command = ["c++", "-std=c++11", *STRICT, f"-I{HEADERS}", str(source), "-o", str(target)]
    subprocess.run(command, check=True, timeout=120)
    subprocess.run([str(target)], check=True, timeout=60)

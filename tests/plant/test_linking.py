"""How compiled code is put together: entry points with all that they call, helpers in nothing else."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from liftgate_plant.compiler import compilable, compiled, enabled, outlined
from liftgate_plant.compiler.kinds import Number

pytestmark = pytest.mark.skipif(not enabled(), reason="needs the compiler")


@pytest.fixture(scope="module", autouse=True)
def empty_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """So that everything here is compiled."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@compilable
def deepest(x: float) -> float:
    if x > 1000.0:
        raise ValueError("too large")
    return x + 1.0


@compilable
def left(x: float) -> float:
    return deepest(2.0 * x)


@compilable
def right(x: float) -> float:
    return deepest(x) * left(x)


@compilable
def diamond(x: float) -> float:
    return left(x) + right(x)


@compilable
def other_entry(x: float) -> float:
    return right(x) - deepest(x)


@outlined
def apart(x: float) -> float:
    return deepest(x) * 3.0


@compilable
def calling(x: float) -> float:
    return apart(x) + apart(2.0 * x) + apart(3.0 * x)


def made_object(function: Any) -> bytes:
    from liftgate_plant.compiler import making

    return making.make(function, [Number("f")], {deepest, left, right, apart}, {apart}).code


def made_code(function: Any) -> bytes:
    from llvmlite.binding import ObjectFileRef

    sections = ObjectFileRef.from_data(made_object(function)).sections()
    return b"".join(each.data() for each in sections if each.is_text())


def test_the_installed_numba_is_one_of_those_whose_inside_is_known():
    from liftgate_plant.compiler import linking

    assert linking.is_possible()
    assert compiled(diamond)(3.0) == diamond(3.0) == 35.0
    assert len(made_code(diamond)) < 1000  # helpers are inlined, and nothing else of them is left


def test_what_makes_it_fast_is_still_there_in_numba():
    from liftgate_plant.compiler import compile_patches

    replaced = *compile_patches._REPLACEMENTS, *compile_patches._REMEMBERED
    assert all(name in vars(owner) for owner, name, _ in replaced)


# A codec: arrays, records, tuples in tuples, branches on None.
MADE_TWICE = """
import hashlib
from llvmlite.binding import ObjectFileRef
from liftgate_hil.running.setup import rig_from
from liftgate_hil.codec.frames import empty_frames
from liftgate_hil.codec.receive import NO_COUNTS, nothing_received, receive
from liftgate_plant.compiler import building, compile_patches
from liftgate_plant.compiler.kinds import kind_of

if not FAST:
    compile_patches._REPLACEMENTS = compile_patches._REMEMBERED = ()
bus = rig_from("liftgate").input_config()
arguments = bus, nothing_received(bus, 40), NO_COUNTS, empty_frames(4), 0
code = building.make_here(receive, [kind_of(each) for each in arguments]).code
for each in ObjectFileRef.from_data(code).sections():
    if each.is_text():
        print(hashlib.sha256(each.data()).hexdigest())
"""


def test_what_makes_it_fast_changes_no_byte_of_it():
    hashes = {
        subprocess.run(
            [sys.executable, "-c", MADE_TWICE.replace("FAST", fast)],
            capture_output=True, text=True, check=True,
        ).stdout
        for fast in ("True", "False")
    }  # fmt: skip
    assert len(hashes) == 1


def test_outlined_code_is_a_separate_function():
    function = rb"\0_ZN(?!08NumbaEnv)[^\0]*5"  # a symbol
    assert re.search(function + b"apart", made_object(calling))
    assert not re.search(function + b"right", made_object(diamond))
    assert compiled(calling)(3.0) == calling(3.0) == 63.0
    with pytest.raises(RuntimeError, match="calling raised an exception"):
        compiled(calling)(500.0)


def test_entry_points_share_helpers():
    assert compiled(diamond)(3.0) == diamond(3.0)
    assert compiled(other_entry)(3.0) == other_entry(3.0)


def test_what_code_raises_is_reported_with_its_name():
    with pytest.raises(RuntimeError, match="diamond raised an exception in machine code"):
        compiled(diamond)(1000.0)
    assert compiled(diamond)(3.0) == 35.0


def test_others_may_call_helpers_too():
    import numba

    compiled(diamond)(3.0)  # numba knows the helpers from now on
    theirs = numba.njit(lambda x: right(x) + 1.0)
    assert theirs(3.0) == right(3.0) + 1.0


def test_without_the_inside_of_numba_it_compiles_as_numba_does(tmp_path: Path):
    code = (
        "from liftgate_plant.compiler import compiled, linking\n"
        "from tests.plant import test_linking as t\n"
        "linking.is_possible = lambda: False\n"
        "code = compiled(t.diamond)\n"
        "assert code(3.0) == 35.0\n"
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr

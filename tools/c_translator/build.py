"""Library of the translated step, and the comparison of the compiled step with it.

Results are reproducible to the bit only without contraction (a * b + c rounded twice), so the fair C builds have
none either. The builds with contraction show in the table what it would gain.
"""

from __future__ import annotations

import ctypes
import math
import shutil
import statistics
import subprocess
import tempfile
import time
import typing
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from liftgate_compiler import compiled
from liftgate_hil.plan.setup import vehicle_from
from liftgate_plant import integrate
from liftgate_plant.bridge import DriveInput
from liftgate_plant.dynamics import Inputs, Plant, State
from liftgate_plant.initial import initial_state
from liftgate_plant.obstacle import Obstacle
from liftgate_plant.vehicle import load_of, plant_of
from tools.c_translator.names import fields_of, is_struct
from tools.c_translator.translate import translate

STEP = 0.001
COUNT = 2000  # steps from the initial state of an operating point
RESTARTS = 10  # such runs in a measurement
ROUNDS = 15

# All members of the structs are doubles, so that an array of them in the order of the fields is the struct.
LOOPS = """
#ifndef ENTRY
#define ENTRY
#endif

ENTRY void step_many(const Plant *plant, State *state, const Inputs *inputs, double step,
        int64_t count)
{
    State now = *state;
    for (int64_t k = 0; k < count; ++k) {
        now = integrate_step(plant, &now, inputs, step);
    }
    *state = now;
}

void restart_many(const Plant *plant, State *state, const Inputs *inputs, double step,
        int64_t count, int64_t restarts)
{
    const State start = *state;
    for (int64_t k = 0; k < restarts; ++k) {
        *state = start;
        step_many(plant, state, inputs, step, count);
    }
}
"""


class Build(NamedTuple):
    """Build of the C code: a compiler and its flags."""

    name: str
    compiler: str
    flags: tuple[str, ...]

    @property
    def is_installed(self) -> bool:
        """Whether the compiler is installed on this machine."""
        return shutil.which(self.compiler) is not None

    @property
    def is_fair(self) -> bool:
        """Whether the results are the same to the bit as those of the plant."""
        return "-ffp-contract=off" in self.flags


_OFF, _FAST = "-ffp-contract=off", "-ffp-contract=fast"
_NATIVE = ("-O3", "-march=native")
# All calls inline, no errno, no traps: none of these changes a result. numba's compiler does the same.
_GCC = (*_NATIVE, "-fno-math-errno", "-fno-trapping-math", "-DENTRY=__attribute__((flatten))")
_CLANG = (*_NATIVE, "-fno-math-errno", "-mllvm", "-inline-threshold=100000")
USUAL = Build("gcc -O2", "gcc", ("-O2", _OFF))
BUILDS = (
    USUAL,
    Build("gcc -O3 native", "gcc", (*_NATIVE, _OFF)),
    Build("gcc, all inline", "gcc", (*_GCC, _OFF)),
    Build("clang, all inline", "clang", (*_CLANG, _OFF)),
    Build("gcc, all inline, FMA", "gcc", (*_GCC, _FAST)),
    Build("clang, all inline, FMA", "clang", (*_CLANG, _FAST)),
)


class Point(NamedTuple):
    """Operating point: the plant, the initial state of a run, and its constant inputs."""

    plant: Plant
    state: State
    inputs: Inputs


class Figures(NamedTuple):
    """Median CPU seconds per step at a point: of the compiled step, and of the translation by build.

    `ratios` are the compiled step's time over a build's, by build and round.
    """

    compiled: float
    translations: dict[str, float]
    ratios: dict[str, list[float]]

    def ratio(self, build: str) -> float:
        """Return the median of the rounds' ratios to a build."""
        return statistics.median(self.ratios[build])

    def fastest(self) -> str:
        """Return the name of the fastest build whose results are the same to the bit."""
        fair = {each.name for each in BUILDS if each.is_fair}
        return min(fair & self.translations.keys(), key=self.translations.__getitem__)


def source() -> str:
    """Return the C source of the step and its loops. Raises TypeError if a member is no float."""
    for kind in (Plant, State, Inputs):
        if any(leaf is not float for leaf in leaves_of(kind)):
            raise TypeError(f"{kind.__name__} has members other than floats")
    return translate(integrate.step) + LOOPS


def leaves_of(kind: Any) -> Iterator[Any]:
    """Yield the types of the scalars of a NamedTuple type, in order."""
    for member in fields_of(kind).values():
        yield from leaves_of(member) if is_struct(member) else [member]


def flat(value: Any) -> Iterator[float]:
    """Yield a NamedTuple's scalars, in order."""
    for member in value:
        yield from flat(member) if isinstance(member, tuple) else [member]


def unflat(kind: Any, numbers: Iterator[float]) -> Any:
    """Return a NamedTuple of type `kind`, made of its scalars in order."""
    hints = typing.get_type_hints(kind)
    return kind._make(
        unflat(hints[name], numbers) if is_struct(hints[name]) else next(numbers) for name in kind._fields
    )


def array(value: Any) -> ctypes.Array[ctypes.c_double]:
    """Return a NamedTuple's scalars as an array for C."""
    numbers = tuple(flat(value))
    return (ctypes.c_double * len(numbers))(*numbers)


def build(how: Build = USUAL, folder: Path | None = None) -> ctypes.CDLL:
    """Build and return the library, in a temporary folder, or in `folder` if its code is to be inspected."""
    with tempfile.TemporaryDirectory() as temporary:
        place = folder or Path(temporary)
        target = place / "step.so"
        (place / "step.c").write_text(source(), encoding="utf-8")
        command = [how.compiler, "-std=c99", *how.flags, "-shared", "-fPIC", "-o", str(target)]
        subprocess.run([*command, str(place / "step.c"), "-lm"], check=True, timeout=120)
        library = ctypes.CDLL(str(target))
    numbers = ctypes.POINTER(ctypes.c_double)
    common: list[Any] = [numbers, numbers, numbers, ctypes.c_double, ctypes.c_int64]
    library.step_many.argtypes, library.step_many.restype = common, None
    library.restart_many.argtypes, library.restart_many.restype = [*common, ctypes.c_int64], None
    return library


def translated_steps(library: ctypes.CDLL, point: Point, step: float, count: int) -> State:
    """Return the state `count` steps later, computed by the translation."""
    state = array(point.state)
    library.step_many(array(point.plant), state, array(point.inputs), step, count)
    result: State = unflat(State, iter(state))
    return result


def many_steps(plant: Plant, state: State, inputs: Inputs, step: float, count: int) -> State:
    """Return the state `count` steps later, computed by the plant."""
    for _ in range(count):
        state = integrate.step(plant, state, inputs, step)
    return state


def many_restarts(plant: Plant, start: State, inputs: Inputs, step: float, count: int, restarts: int) -> State:
    """Repeat `count` steps from the same state, `restarts` times, and return the final state."""
    state = start
    for _ in range(restarts):
        state = start
        for _ in range(count):
            state = integrate.step(plant, state, inputs, step)
    return state


def points() -> dict[str, Point]:
    """Return the operating points of the reference SUV by name; each lasts for COUNT steps."""
    vehicle = vehicle_from("suv")
    plant = plant_of(vehicle)
    load = load_of(vehicle)
    free = load._replace(latch_released=1.0)
    rod = Obstacle(math.radians(40.0), 0.9, 20e3, 50.0, 0.0, 1.0)
    opening, closing = DriveInput(0.6, 0.0, 0.0), DriveInput(-1.0, 0.0, 0.0)
    brake, coast = DriveInput(0.0, 0.0, 0.0), DriveInput(0.0, 0.0, 1.0)
    closed = initial_state(plant, 0.0, latched=True)
    half = initial_state(plant, math.radians(45.0))
    # The runs at the open stop and onto the rod are in contact from early on until the end.
    return {
        "moving open": Point(plant, initial_state(plant, 0.1), Inputs(opening, opening, free)),
        "at rest, latched": Point(plant, closed, Inputs(brake, brake, load)),
        "closing onto a rod": Point(plant, half, Inputs(closing, closing, free._replace(obstacle=rod))),
        "at the open stop": Point(
            plant, initial_state(plant, vehicle.gate.open_angle), Inputs(opening, opening, free)
        ),
        "coasting down": Point(plant, half, Inputs(coast, coast, free._replace(snow_mass=30.0))),
    }


def compare(rounds: int = ROUNDS, builds: Sequence[Build] = BUILDS) -> dict[str, Figures]:
    """Return the figures by operating point: the compiled step and each installed build, in turns."""
    libraries = {each.name: build(each) for each in builds if each.is_installed}
    restarts = compiled(many_restarts)
    return {name: _figures(point, libraries, restarts, rounds) for name, point in points().items()}


_OURS = ""


def _figures(
    point: Point, libraries: dict[str, ctypes.CDLL], restarts: Callable[..., State], rounds: int
) -> Figures:
    arrays = [array(part) for part in point]

    def run(name: str) -> None:
        if name == _OURS:
            restarts(*point, STEP, COUNT, RESTARTS)
        else:
            state = array(point.state)
            libraries[name].restart_many(arrays[0], state, arrays[2], STEP, COUNT, RESTARTS)

    times: dict[str, list[float]] = {_OURS: [], **{name: [] for name in libraries}}
    for name in times:
        run(name)
    for number in range(rounds):
        # Forwards and backwards, so that a drift affects all alike. CPU time: others may use the machine.
        for name in times if number % 2 else reversed(times):
            start = time.thread_time()
            run(name)
            times[name].append((time.thread_time() - start) / (COUNT * RESTARTS))
    return Figures(
        statistics.median(times[_OURS]),
        {name: statistics.median(times[name]) for name in libraries},
        {name: [a / b for a, b in zip(times[_OURS], times[name], strict=True)] for name in libraries},
    )

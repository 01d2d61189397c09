"""Page docs/vehicle.md: all keys of a vehicle file, from the fields of the plant's tables."""

from __future__ import annotations

import inspect
import sys
import tomllib
from collections.abc import Iterator, Mapping
from typing import Any, get_type_hints

from liftgate_hil.config.parameters import BODY_TABLES, DRIVE_TABLES
from liftgate_hil.config.shipped import data_root, shipped_names
from liftgate_hil.config.variant import SpreadTable
from liftgate_plant.quantity import Quantity
from tools.docs.markdown import code, number, page, table
from tools.docs.schema import key_table

_INTRO = """\
A vehicle file is written in TOML. It contains the parameters of one gate and its drives. It is used by
`--vehicle`, a scenario's `vehicle` and `liftgate_hil.Gate(vehicle=…)`. `liftgate-hil init` copies one to start
from. Values are in the unit shown; ranges are inclusive. Any key can be replaced on the command line (`--set
motor.resistance=0.8`) and in a scenario's `[set]`, and estimated by `identify --estimate motor.resistance`.

`drives` is 2 (left and right) or 1 (left only). The tables of a drive apply to both drives. A table for one
drive, such as `[left.motor]` or `[right.spring]`, contains the keys in which that drive differs. The table
`[identification]`, which `identify --save-vehicle` writes, states the uncertainty of the values; the model does
not depend on it.

## One car of a production: `[spread]`

The table `[spread]` describes how the cars of a production differ. `--draw SEED` (`draw=` of the API) draws one
of these cars at random. Without it, the car has the file's values. The structure of the table is that of the
file: `[spread.motor] resistance = { relative = 0.03 }`, or `[spread.left.motor]` for one drive. Keys of a drive
are drawn for each drive separately. A value that is given by `--set` or by a scenario's `[set]` is not changed."""

_VARIATION = """\
Normal and lognormal distributions are truncated at 3 σ, and every value at the range of its key. Each value
depends only on the seed and on its own key: a further key in the table does not change the other values.

`--ideal` (`ideal=True`) is the opposite: the plant of the thesis. It has no errors of `[sensors]`, no pinch
strips, no torsion, no source resistance, no PWM ripple, no slip clutch, no thermal cut-out and no heating. Its
friction does not depend on temperature, position, run or age. Values that are given by `--set` still apply.

## Friction over the travel and over life

The friction of a drive is the nominal friction law (3.3, 3.8, 3.11) times the factor `(1 + run_in
e^(−cycles/run_in_cycles) + wear cycles/1000) (1 + run_deviation v) (t(x) + eccentricity cos(2π x/lead + ψ) +
position_deviation g(x))`, with the spindle's travel x and:

- `t`: `position_table`, pairs of a share of the travel and a factor (`[[0, 1.2], [0.5, 0.9], [1, 1]]`),
- `g`: a random profile of unit variance whose autocorrelation is 1/e after `position_length`,
- `ψ`: a random angle; `g` and `ψ` are determined by `position_profile` and the drive,
- `v`: a normally distributed random number, determined by the run's `--seed` and the drive.

## The bridge's PWM, and where the shunt is

With `pwm_frequency = 0` a motor gets the mean voltage of its PWM. With a frequency, its current has a ripple
that depends on `freewheeling`, the path of the current while the PWM is off: `slow` (shorted by a transistor),
`diode` (through one diode) or `fast` (all switches off). With diodes the current may reach zero within each
period; this changes its mean. Recordings contain the RMS value and the peak of each tick (`left_current_rms_a`,
`left_current_peak_a`). The ripple heats the winding.

After a step of the duty, the mean current settles with the winding's time constant L/R. With a PWM frequency,
the voltage of the source drops by what both bridges draw in each part of the period. If both frequencies are the
same, both periods begin at the same instant. The terminal voltage is the mean over the period. With
`pwm_frequency = 0` the source supplies the mean of the PWM, as if a capacitor at the bridges buffered each
period.

With `shunt_low_side = 1` the shunt is in the ground line of the bridge. It measures the current that the source
supplies: the duty's share of the motor current, and nothing while the motor brakes. With `shunt_sampled_on = 1`
it is read while the PWM is on. `current_window` is the length of the windows over which the current is averaged;
for a window that is synchronous with the PWM, choose a multiple of the PWM period.

The column `suv` contains the value of the reference vehicle, if its file gives one."""


def vehicle_page() -> str:
    """Return the text of the page."""
    suv = tomllib.loads((data_root() / "configs/vehicles/suv.toml").read_text(encoding="utf-8"))
    parts = [_INTRO, key_table(SpreadTable), _VARIATION]
    for title, tables in (("Of each drive", DRIVE_TABLES), ("Of the gate", BODY_TABLES)):
        parts.append(f"## {title}")
        for name, kind in tables.items():
            parts += [f"### `[{name}]`", _source(kind), _keys(kind, suv.get(name, {}))]
    parts += ["## Where the numbers of the shipped vehicles come from", *_origins()]
    return page("Vehicle files", *parts)


def _source(kind: type) -> str:
    """Return the first line of the docstring of a table's module, which names the equations, and a link to it."""
    module = sys.modules[kind.__module__]
    first = (inspect.getdoc(module) or "").split("\n\n")[0].replace("\n", " ")
    file = module.__name__.removeprefix("liftgate_plant.") + ".py"
    return f"{first} [`{file}`](../plant/liftgate_plant/{file})"


def _keys(kind: type, suv: Mapping[str, Any]) -> str:
    heads = ("key", "symbol", "unit", "range", "default", "suv", "meaning")
    return table(heads, _rows(kind, suv))


def _rows(kind: Any, suv: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    for field, hint in get_type_hints(kind, include_extras=True).items():
        quantity: Quantity = hint.__metadata__[0]
        key = field + quantity.suffix
        default = kind._field_defaults.get(field)
        if quantity.options:
            options = ", ".join(code(each) for each in quantity.options)
            shown = [code(str(each)) if each else "" for each in (default, suv.get(key))]
            yield code(key), "", "", options, *shown, quantity.meaning
            continue
        yield (
            code(key),
            quantity.symbol,
            "" if quantity.unit == "1" else quantity.unit,
            quantity.range,
            "required" if default is None else _shown(default, quantity.scale),
            _shown(suv.get(key)),
            quantity.meaning,
        )


def _shown(value: Any, scale: float = 1.0) -> str:
    """Return the text of a file's value, from the value in memory, which is `scale` times that of the file."""
    if value is None:
        return ""
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_shown(each, scale) for each in value) + "]"
    return number(value / scale)


def _origins() -> Iterator[str]:
    """Yield the comment at the head of each shipped vehicle file, with a link to the file."""
    for name in sorted(shipped_names("configs/vehicles"), key=lambda name: (name != "suv", name)):
        text = (data_root() / f"configs/vehicles/{name}.toml").read_text(encoding="utf-8")
        lines = []
        for line in text.splitlines():
            if not line.startswith("#"):
                break
            lines.append(line.removeprefix("#").strip())
        yield f"[`{name}`](../configs/vehicles/{name}.toml): {' '.join(lines)}"

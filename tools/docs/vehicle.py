"""docs/vehicle.md: every key of a vehicle file, from the fields of the plant's tables."""

from __future__ import annotations

import inspect
import sys
import tomllib
from collections.abc import Iterator, Mapping
from typing import Any, get_type_hints

from liftgate_hil.config.shipped import data_root, shipped_names
from liftgate_hil.config.vehicle_keys import BODY_TABLES, DRIVE_TABLES
from liftgate_plant.quantity import Quantity
from tools.docs.markdown import code, number, page, table

_INTRO = """\
A vehicle file is TOML: the parameters of one gate and its drives, for `--vehicle`, a scenario's `vehicle` and
`liftgate_hil.Gate(vehicle=…)`. `liftgate-hil init` copies one to start from. Values are in the unit shown;
ranges are inclusive. Any key can be replaced on the command line, `--set motor.resistance=0.8`, in a
scenario's `[set]`, and found by `identify --estimate motor.resistance`.

`drives` is 2 (left and right) or 1 (left only). The tables of a drive are given once for both, or for one of
them: `[left.motor]` or `[right.spring]` hold the keys in which that drive differs. A table
`[identification]`, which `identify --save-vehicle` writes, says how sure the values are; nothing depends on
it.

## One car of a production: `[spread]`

`--draw SEED` (`draw=` of the API) makes one car of those that the table `[spread]` speaks of; without it, every
car has the file's values. The table mirrors the file's: `[spread.motor] resistance = { relative = 0.03 }`, or
for one drive `[spread.left.motor]`. What belongs to a drive is drawn for each. A value that `--set` or a
scenario's `[set]` gives holds.

| key | is |
| --- | --- |
| `distribution` | `normal` (default), `lognormal` or `uniform` |
| `relative` | σ, or half the width of `uniform`, as a share of the value; of `lognormal` σ of its logarithm |
| `absolute` | the same in the key's unit |
| `low`, `high` | the ends of `uniform` |
| `follow` | keys that change by the same factor: `["motor.speed_constant"]` |

Normal and lognormal ones end at 3 σ, and each at its key's range. A car depends on its seed and on each key by
itself, so that another key in the table leaves the rest of it as it was.

`--ideal` (`ideal=True`) is the opposite: the thesis's plant, without any error of `[sensors]`, without torsion,
source resistance and heating, and with a friction that neither temperature, place, run nor age changes. What
`--set` gives still holds.

## Friction over the travel and over life

The friction of the gear and the spindle is that of the law (3.3, 3.8, 3.11) times `(1 + run_in
e^(−cycles/run_in_cycles) + wear cycles/1000) (1 + run_deviation v) (t(x) + eccentricity cos(2π x/lead + ψ) +
position_deviation g(x))`: `t` is `position_table`, pairs of a share of the travel and a factor (`[[0, 1.2],
[0.5, 0.9], [1, 1]]`), `g` a random profile of unit variance whose autocorrelation is 1/e after
`position_length`, ψ an angle, both those of `position_profile` and of the drive; `v` is a normal number of the
run's `--seed`.

## The bridge's PWM, and where the shunt is

With `pwm_frequency = 0` a motor sees the mean of its PWM. With a frequency its current has the ripple of the
`freewheeling` while the PWM is off: `slow` (shorted by a transistor), `diode` (through one diode), `fast` (all
switches off); with diodes it may end within each period, which lowers its mean. Recordings have the effective
value and the peak of each tick (`left_current_rms_a`, `left_current_peak_a`); the ripple warms the winding.

After a step of the duty the mean goes to its new course with the winding's L/R. With a frequency the source sags
by what both bridges draw in each part of the period, of which both begin at once where their frequencies are one;
the terminal voltage is its mean over the period. With `pwm_frequency = 0` the source carries the mean of the
PWM, as if a capacitor at the bridges buffered a period.

`shunt_low_side = 1` puts the shunt into the bridge's ground: it sees what the source gives, so the duty's share
of the current and nothing while the motor brakes; with `shunt_sampled_on = 1` it is read while the PWM is on.
`current_window` is the length of the windows whose mean is read, a multiple of the PWM's period for one that is
in step with it.

The column `suv` has the reference vehicle's value where its file gives one."""


def vehicle_page() -> str:
    """The page."""
    suv = tomllib.loads((data_root() / "configs/vehicles/suv.toml").read_text(encoding="utf-8"))
    parts = [_INTRO]
    for title, tables in (("Of each drive", DRIVE_TABLES), ("Of the gate", BODY_TABLES)):
        parts.append(f"## {title}")
        for name, kind in tables.items():
            parts += [f"### `[{name}]`", _source(kind), _keys(kind, suv.get(name, {}))]
    parts += ["## Where the numbers of the shipped vehicles come from", *_origins()]
    return page("Vehicle files", *parts)


def _source(kind: type) -> str:
    """The first line of the module's docstring, which names the equations, with the way there."""
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
    """A value of a file, or one in memory that is `scale` times it."""
    if value is None:
        return ""
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_shown(each, scale) for each in value) + "]"
    return number(value / scale)


def _origins() -> Iterator[str]:
    """The comment at the head of each shipped file."""
    for name in sorted(shipped_names("configs/vehicles"), key=lambda name: (name != "suv", name)):
        text = (data_root() / f"configs/vehicles/{name}.toml").read_text(encoding="utf-8")
        lines = []
        for line in text.splitlines():
            if not line.startswith("#"):
                break
            lines.append(line.removeprefix("#").strip())
        yield f"[`{name}`](../configs/vehicles/{name}.toml): {' '.join(lines)}"

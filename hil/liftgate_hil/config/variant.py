"""Variants of a vehicle: as in the file, drawn at random from its `[spread]`, or without imperfections.

The latter two override values of the file, as KEY=VALUE does; KEY=VALUE overrides them in turn. The table
`[spread]` says how the cars of a production differ from the file's values:

    [spread.motor]
    resistance = { relative = 0.03 }                                # normal, σ is 3 % of the value
    torque_constant = { relative = 0.04, follow = ["motor.speed_constant"] }     # the same magnets
    [spread.spring]
    preload = { distribution = "uniform", relative = 0.05 }
    [spread.sensors]
    current_offset = { absolute = 0.05 }                            # A

Keys of a drive are drawn for each drive. A draw depends only on its seed and the key, so that another key in the
table does not change the rest. Normal and lognormal draws are limited to 3 σ, and every draw to the key's range.
"""

import copy
import itertools
import math
import zlib
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, NamedTuple

from liftgate_hil.config.described import Field, Record, read_record
from liftgate_hil.config.kinds import Choice, Number, Raw
from liftgate_hil.config.parameters import BODY_TABLES, DRIVE_TABLES, Key, keys_of
from liftgate_hil.config.settings import Setting, applied
from liftgate_hil.config.toml import Table, is_number, number, show, table, value_at
from liftgate_hil.errors import ConfigError, ConfigIssues
from liftgate_plant.noise import gaussian, uniform
from liftgate_plant.quantity import Points
from liftgate_plant.signals import SIDES

DISTRIBUTIONS = ("normal", "lognormal", "uniform")
_MOST = 1e12  # limit of a value or a width, beyond the ranges of all keys
_TAIL = 3.0  # σ
_TRIALS = 64  # attempts at a normal draw within _TAIL; one in 10¹⁶⁵ fails

Names = tuple[str, ...]
_END = Raw("a number within the range of the key")

# fmt: off
# A field with its key is a row of a table.


class SpreadTable(Record):
    """The keys of an entry in the table `[spread]`."""

    distribution: Annotated[str, Field(Choice(DISTRIBUTIONS), "distribution of the value")] = "normal"
    relative: Annotated[float | None, Field(Number(0.0, 1.0), "σ, or half the width of `uniform`, as a share "
        "of the value; for `lognormal` σ of the logarithm")] = None
    absolute: Annotated[float | None, Field(Number(0.0, _MOST), "the same in the key's unit")] = None
    low: Annotated[Any, Field(_END, "lower limit of `uniform`, together with `high`")] = None
    high: Annotated[Any, Field(_END, "upper limit of `uniform`")] = None
    follow: Annotated[Any, Field(Raw("a list of keys"), "keys that change by the same factor: "
        "`[\"motor.speed_constant\"]`")] = ()


# fmt: on


class Spread(NamedTuple):
    """Random distribution of the value of a key of a vehicle file."""

    names: Names  # table and key, or side, table and key
    distribution: str
    relative: float  # σ, or half width, as a share of the value; of lognormal: σ of the logarithm
    absolute: float  # σ, or half width, in the key's unit
    ends: tuple[float, float] | None  # low and high of uniform, if given instead of a width
    follow: tuple[Names, ...]  # keys that change by the same factor


def spreads_of(issues: ConfigIssues, raw: Table) -> list[Spread]:
    """Return the distributions in the table `[spread]` of a file's content; issues are noted."""
    result = []
    for names, entry in _entries(table(issues, "spread", raw.get("spread", {})), ()):
        dotted = ".".join(("spread", *names))
        if key_of(names) is None:
            issues.add(dotted, f"{show(entry)}: unknown key; allowed: keys of this file's tables")
            continue
        if names[0] == "right" and raw.get("drives") == 1:
            issues.add(dotted, "this gate has drives = 1, the left one; allowed: no such key")
        elif isinstance(entry, dict):
            before = issues.count
            spread = _spread_of(issues, dotted, names, entry)
            result += [spread] if issues.count == before else []
        else:
            issues.add(dotted, f"{show(entry)}; allowed: a table, e.g. {{ relative = 0.03 }}")
    return result


def key_of(names: Names) -> Key | None:
    """Return the numeric key of a vehicle file whose dotted name has these parts; None if there is none."""
    is_sided = len(names) == 3 and names[0] in SIDES
    tables = DRIVE_TABLES if is_sided else {**DRIVE_TABLES, **BODY_TABLES}
    if len(names) != 2 + is_sided or names[-2] not in tables:
        return None
    key = keys_of(tables[names[-2]]).get(names[-1])
    return key if key is not None and key.kind is float else None


def _entries(content: Table, above: Names) -> Iterator[tuple[Names, Any]]:
    """Yield the dotted name, split, and the value of each entry of `[spread]`, whether nested or dotted."""
    for name, value in content.items():
        names = (*above, *name.split("."))
        depth = 3 if names[0] in SIDES else 2
        if isinstance(value, dict) and len(names) < depth:
            yield from _entries(value, names)
        else:
            yield names, value


def _spread_of(issues: ConfigIssues, dotted: str, names: Names, entry: Table) -> Spread:
    """Return the distribution of a key by its entry in `[spread]`; issues are noted."""
    given = read_record(issues, dotted, entry, SpreadTable)
    distribution = given.distribution
    ways = {"relative": ("relative",), "absolute": ("absolute",), "low and high": ("low", "high")}
    allowed = {"normal": 2, "lognormal": 1, "uniform": 3}.get(distribution, 3)
    choice = [way for way in list(ways)[:allowed] if all(each in entry for each in ways[way])]
    widths = {each for each in entry if each in ("relative", "absolute", "low", "high")}
    if len(choice) != 1 or widths != set(ways[choice[0]]):
        issues.add(
            dotted,
            f"{show(entry)}; allowed: one of {', '.join(list(ways)[:allowed])} with distribution = {distribution}",
        )
    ends = None
    if given.low is not None and given.high is not None:
        key = key_of(names)
        assert key is not None
        low = number(issues, f"{dotted}.low", given.low, key.quantity.low, key.quantity.high)
        high = number(issues, f"{dotted}.high", given.high, key.quantity.low, key.quantity.high)
        if low > high:
            issues.add(f"{dotted}.low", f"{low:g} above high = {high:g}; allowed: up to high")
        ends = (low, high)
    followers = _followers(issues, dotted, names, given.follow)
    return Spread(names, distribution, given.relative or 0.0, given.absolute or 0.0, ends, followers)


def _followers(issues: ConfigIssues, dotted: str, names: Names, given: Any) -> tuple[Names, ...]:
    """Return the full names of the keys in an entry's `follow`; issues are noted."""
    is_drive = names[-2] in DRIVE_TABLES
    if not isinstance(given, list | tuple) or not all(isinstance(each, str) for each in given):
        issues.add(f"{dotted}.follow", f"{show(given)}; allowed: a list of keys")
        return ()
    result = []
    for each in given:
        follower = (*names[:-2], *each.split("."))
        if key_of(follower) is None or (follower[-2] in DRIVE_TABLES) != is_drive:
            kind = "a drive" if is_drive else "the gate"
            issues.add(f"{dotted}.follow", f"{show(each)}; allowed: TABLE.KEY of a number of {kind}")
        else:
            result.append(follower)
    return tuple(result)


def drawn(raw: Table, spreads: Sequence[Spread], seed: int) -> dict[Names, float]:
    """Return one car's values drawn by `seed`, in the file's units, by name; a drive's keys once per drive."""
    result: dict[Names, float] = {}
    for spread in spreads:
        for place in _places(spread.names):
            if place[0] == "right" and raw.get("drives") == 1:
                continue
            nominal = _value(raw, place)
            if nominal is None:  # reported by other issues of the file
                continue
            result[place] = _within(place, _draw(spread, nominal, seed, place))
            factor = result[place] / nominal if nominal else 1.0
            for follower in spread.follow:
                own = (*place[:-2], *follower[-2:])
                if (value := _value(raw, own)) is not None:
                    result[own] = _within(own, factor * value)
    return result


def _places(names: Names) -> list[Names]:
    """Return the full names of a key in a car: one, or one in each drive."""
    if len(names) == 2 and names[0] in DRIVE_TABLES:
        return [(side, *names) for side in SIDES]
    return [names]


def _value(raw: Table, names: Names) -> float | None:
    """Return a key's value in the file, or its default, in the file's unit; None: neither, or no valid number."""
    key = key_of(names)
    assert key is not None
    for path in (names, names[-2:]):
        place = value_at(raw, path)
        if place is not None:
            return float(place) if is_number(place) and abs(place) <= _MOST else None
    return None if key.default is None else float(key.default / key.quantity.scale)


def _draw(spread: Spread, nominal: float, seed: int, place: Names) -> float:
    """Return the value that seed and key determine at random: about `nominal`, or between the spread's ends."""
    channel = zlib.crc32(".".join(place).encode())
    if spread.distribution == "uniform":
        share = uniform(seed, 0, channel)
        if spread.ends is not None:
            return spread.ends[0] + share * (spread.ends[1] - spread.ends[0])
        return nominal + (2.0 * share - 1.0) * (spread.relative * abs(nominal) + spread.absolute)
    deviation = next(
        (each for each in (gaussian(seed, k, channel) for k in range(_TRIALS)) if abs(each) <= _TAIL), 0.0
    )
    if spread.distribution == "lognormal":
        return nominal * math.exp(spread.relative * deviation)
    return nominal + deviation * (spread.relative * abs(nominal) + spread.absolute)


def _within(place: Names, value: float) -> float:
    """Return a value limited to the allowed range of its key, and rounded down if that must be whole."""
    key = key_of(place)
    assert key is not None
    within = min(max(math.floor(value) if key.quantity.is_whole else value, key.quantity.low), key.quantity.high)
    return key.quantity.least if 0.0 < within < key.quantity.least else within


# Keys that say how the sensors are built, not what errors they have.
_BUILD = (
    "hall_counts",
    "hall_sample_period",
    "acceleration_distance",
    "current_limit",
    "current_window",
    "shunt_low_side",
    "shunt_sampled_on",
    "commutator_segments",
    "commutator_brushes",
)
_LAW = ("static_ratio", "stribeck_speed", "viscous")  # keys of friction over speed
_TABLES = {**DRIVE_TABLES, **BODY_TABLES}
IDEAL = {
    "friction": tuple(key for key in keys_of(DRIVE_TABLES["friction"]) if key not in _LAW),
    "thermal": ("enabled",),
    "clutch": ("torque",),
    "cutout": ("resistance",),
    "bridge": ("pwm_frequency", "freewheeling"),
    "sensors": tuple(key for key in keys_of(BODY_TABLES["sensors"]) if key not in _BUILD),
    "gate": ("torsional_stiffness", "torsional_damping", "torsional_inertia"),
    "supply": ("internal_resistance",),
}


class Variant(NamedTuple):
    """Choice of a vehicle file's variant: as it is, drawn at random, or ideal."""

    draw: int | None = None  # seed of a car drawn from the production; None: none is drawn
    is_ideal: bool = False  # the thesis's plant: no sensor errors, torsion, source resistance or wear

    def check(self) -> None:
        """Raise ConfigError if both a random draw and the ideal car are requested."""
        if self.draw is not None and self.is_ideal:
            raise ConfigError(f"`draw` {self.draw}: allowed without `ideal`, which has no spread")


AS_FILED = Variant()


def settings_for(raw: Table, variant: Variant, settings: Sequence[Setting], source: str) -> list[Setting]:
    """Return the settings that turn the content `raw` into a variant, then `settings`. Raises ConfigError."""
    variant.check()
    if variant.is_ideal:
        own = _ideal(raw)
    elif variant.draw is not None:
        own = _drawn(raw, variant.draw, settings, source)
    else:
        own = []
    return [*own, *settings]


def _ideal(raw: Table) -> list[Setting]:
    """Return settings that replace the file's imperfections by the keys' defaults, which are ideal."""
    result = []
    for path in [*((name,) for name in IDEAL), *itertools.product(SIDES, IDEAL)]:
        given = value_at(raw, path)
        if not isinstance(given, dict):
            continue
        for key, about in keys_of(_TABLES[path[-1]]).items():
            if key in IDEAL[path[-1]] and key in given:
                value = about.default
                if about.kind is Points:
                    value = []
                elif about.kind is float:
                    value /= about.quantity.scale
                result.append(Setting((*path, key), value, "`ideal` "))
    return result


def _drawn(raw: Table, seed: int, settings: Sequence[Setting], source: str) -> list[Setting]:
    """Return a car's settings drawn by `seed`, except `settings`. Raises ConfigError for a missing `[spread]`."""
    nominal = copy.deepcopy(raw)
    issues = ConfigIssues(source, applied(nominal, settings))
    spreads = spreads_of(issues, nominal)
    issues.raise_if_any()
    if not spreads:
        raise ConfigError(f"`draw` {seed}: {source} has no table [spread]; allowed: a vehicle with one")
    kept = {setting.names for setting in settings}
    return [
        Setting(names, value, f"`draw` {seed}: ")
        for names, value in drawn(nominal, spreads, seed).items()
        if names not in kept and names[-2:] not in kept
    ]

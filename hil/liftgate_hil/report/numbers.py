"""Formatting of numbers, names and units in reports."""

from __future__ import annotations

import math

NONE = "—"  # stands for a number that does not exist

_UNITS = {
    "a": "A",
    "v": "V",
    "n": "N",
    "s": "s",
    "rev": "rev",
    "rps": "rev/s",
    "deg": "deg",
    "degps": "deg/s",
    "degc": "°C",
}


def clean(text: str, longest: int = 1000) -> str:
    """Return a text with � for control characters, shortened in the middle to `longest` characters."""
    shown = "".join(each if each.isprintable() else "\ufffd" for each in text)
    if len(shown) <= longest:
        return shown
    head = (longest - 1) // 2
    return f"{shown[:head]}…{shown[len(shown) - (longest - 1 - head) :]}"


def column_label(column: str) -> tuple[str, str]:
    """Return the words and the unit of a column, ("left current", "A"), or its name and no unit."""
    words, _, suffix = column.rpartition("_")
    if words and suffix in _UNITS:
        return clean(words.replace("_", " "), 40), _UNITS[suffix]
    if column.endswith("_hall_count"):
        return clean(column.removesuffix("_hall_count")) + " Hall count", "counts"
    if column.endswith("_duty"):
        return clean(column.replace("_", " "), 40), ""
    return clean(column, 40), ""


def axis_label(column: str) -> str:
    """Return the axis label of a column, with its unit."""
    words, unit = column_label(column)
    return f"{words} [{unit}]" if unit else words


def significant(value: float, digits: int = 4) -> str:
    """Return a number as text with `digits` significant digits, including trailing zeros; NaN as a dash."""
    if not math.isfinite(value):
        return NONE if math.isnan(value) else ("∞" if value > 0.0 else "-∞")
    if value == 0.0:
        return "0"
    exponent = int(f"{value:.{digits - 1}e}".partition("e")[2])
    if -4 <= exponent < 6:
        return f"{value:.{max(digits - 1 - exponent, 0)}f}"
    return f"{value:.{digits - 1}e}"


def known_digits(value: float, std: float) -> str:
    """Return a value as text to the second digit of its standard deviation: 2.128 for 2.12797 ± 0.0218."""
    if not math.isfinite(value) or value == 0.0 or not math.isfinite(std):
        return significant(value, 3)
    if std <= 0.0:
        return significant(value, 6)
    last = int(f"{std:.1e}".partition("e")[2]) - 1
    first = int(f"{value:.8e}".partition("e")[2])
    return significant(value, min(max(first - last + 1, 2), 9))


def plain(value: float) -> str:
    """Return a number as text, rounded to at most six significant digits."""
    return f"{value:.6g}" if math.isfinite(value) else significant(value)


def deviation(std: float) -> str:
    """Return a standard deviation as text with two digits, or a dash where there is none."""
    return significant(std, 2) if math.isfinite(std) else NONE


def percent(share: float, sign: str = "") -> str:
    """Return a number of percent as text without %; `sign` "+" always shows its sign. A dash if not finite."""
    if not math.isfinite(share):
        return NONE
    if abs(share) >= 1e5:
        return f"{share:{sign}.0e}"
    places = 0 if abs(share) >= 100.0 else 1 if abs(share) >= 1.0 else 2
    return f"{share:{sign}.{places}f}"


def relative_error(value: float, std: float) -> float:
    """Return a standard deviation in % of its value; NaN for a value of 0 or an infinite deviation."""
    return 100.0 * std / abs(value) if value != 0.0 and math.isfinite(std) else math.nan


def relative_change(value: float, initial: float) -> float:
    """Return the change in % of the initial value; NaN for an initial value of 0."""
    return 100.0 * (value - initial) / abs(initial) if initial != 0.0 else math.nan


def fit(value: float) -> str:
    """Return a model's fit in % as text with two decimals, which show the difference between good models."""
    if not math.isfinite(value):
        return NONE if math.isnan(value) else significant(value)
    return f"{value:.2f}" if abs(value) < 1e5 else f"{value:.1e}"

"""How reports write numbers and names."""

from __future__ import annotations

import math

NONE = "—"  # no such number

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
    """A name from a file, without what would steer a terminal or break a page; its middle left out if long."""
    shown = "".join(each if each.isprintable() else "\ufffd" for each in text)
    if len(shown) <= longest:
        return shown
    head = (longest - 1) // 2
    return f"{shown[:head]}…{shown[len(shown) - (longest - 1 - head) :]}"


def column_label(column: str) -> tuple[str, str]:
    """Words and unit of a column: ("left current", "A"); the column itself and no unit where it has none."""
    words, _, suffix = column.rpartition("_")
    if words and suffix in _UNITS:
        return clean(words.replace("_", " "), 40), _UNITS[suffix]
    if column.endswith("_hall_count"):
        return clean(column.removesuffix("_hall_count")) + " Hall count", "counts"
    return clean(column, 40), ""


def axis_label(column: str) -> str:
    """A column's label with its unit."""
    words, unit = column_label(column)
    return f"{words} [{unit}]" if unit else words


def significant(value: float, digits: int = 4) -> str:
    """A number with so many significant digits, the trailing zeros kept: they are known."""
    if not math.isfinite(value):
        return NONE if math.isnan(value) else ("∞" if value > 0.0 else "-∞")
    if value == 0.0:
        return "0"
    exponent = int(f"{value:.{digits - 1}e}".partition("e")[2])
    if -4 <= exponent < 6:
        return f"{value:.{max(digits - 1 - exponent, 0)}f}"
    return f"{value:.{digits - 1}e}"


def known_digits(value: float, std: float) -> str:
    """A value to the second digit of its standard deviation: 2.128 for 2.12797 ± 0.0218."""
    if not math.isfinite(value) or value == 0.0 or not math.isfinite(std):
        return significant(value, 3)
    if std <= 0.0:
        return significant(value, 6)
    last = int(f"{std:.1e}".partition("e")[2]) - 1
    first = int(f"{value:.8e}".partition("e")[2])
    return significant(value, min(max(first - last + 1, 2), 9))


def plain(value: float) -> str:
    """A number as given, at most six digits."""
    return f"{value:.6g}" if math.isfinite(value) else significant(value)


def deviation(std: float) -> str:
    """A standard deviation: two digits, a dash where there is none."""
    return significant(std, 2) if math.isfinite(std) else NONE


def percent(share: float, sign: str = "") -> str:
    """A share in %, without the sign %; `sign` "+" shows it always."""
    if not math.isfinite(share):
        return NONE
    if abs(share) >= 1e5:
        return f"{share:{sign}.0e}"
    places = 0 if abs(share) >= 100.0 else 1 if abs(share) >= 1.0 else 2
    return f"{share:{sign}.{places}f}"


def relative_error(value: float, std: float) -> float:
    """Standard deviation in % of the value; NaN where that says nothing."""
    return 100.0 * std / abs(value) if value != 0.0 and math.isfinite(std) else math.nan


def relative_change(value: float, initial: float) -> float:
    """Change in % of the initial value; NaN where that was zero."""
    return 100.0 * (value - initial) / abs(initial) if initial != 0.0 else math.nan


def fit(value: float) -> str:
    """A fit in %, two decimals: the difference between good models is in them."""
    if not math.isfinite(value):
        return NONE if math.isnan(value) else significant(value)
    return f"{value:.2f}" if abs(value) < 1e5 else f"{value:.1e}"

"""Probability distributions of varied values, as quantile functions; confidence interval of a proportion."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.config.kinds import SEED
from liftgate_hil.errors import ConfigError

Floats = NDArray[np.float64]

# Quantiles of unbounded distributions are limited to these, 5.6 σ of a normal one.
_LEAST = 1e-8
_CALL = re.compile(r"\s*(\w+)\s*\(([^()]*)\)\s*")


class Family(NamedTuple):
    """Family of distributions, e.g. `uniform`: argument names, their constraint, quantiles of (u, *arguments)."""

    arguments: str
    allowed: str
    is_sound: Callable[..., bool]
    quantile: Callable[..., Floats]


def _normal(u: Floats) -> Floats:
    from scipy.special import ndtri

    found: Floats = ndtri(np.clip(u, _LEAST, 1.0 - _LEAST))
    return found


def _triangular(u: Floats, low: float, mode: float, high: float) -> Floats:
    share = (mode - low) / (high - low)
    rising = low + np.sqrt(u * (high - low) * (mode - low))
    falling = high - np.sqrt((1.0 - u) * (high - low) * (high - mode))
    return np.where(u < share, rising, falling)


FAMILIES: Mapping[str, Family] = {
    "uniform": Family(
        "low, high", "low < high", lambda low, high: low < high, lambda u, low, high: low + u * (high - low)
    ),
    "loguniform": Family(
        "low, high",
        "0 < low < high",
        lambda low, high: 0.0 < low < high,
        lambda u, low, high: np.minimum(low * (high / low) ** u, high),
    ),
    "normal": Family(
        "mean, std", "std > 0", lambda mean, std: std > 0.0, lambda u, mean, std: mean + std * _normal(u)
    ),
    "lognormal": Family(
        "median, sigma",
        "median > 0, sigma > 0 (std of the logarithm)",
        lambda median, sigma: median > 0.0 and sigma > 0.0,
        lambda u, median, sigma: median * np.exp(sigma * _normal(u)),
    ),
    "triangular": Family(
        "low, mode, high",
        "low <= mode <= high, low < high",
        lambda low, mode, high: low <= mode <= high and low < high,
        _triangular,
    ),
    "integer": Family(
        "low, high",
        f"whole numbers, low < high, up to {SEED.high} of them",
        lambda low, high: low % 1.0 == high % 1.0 == 0.0 and 0.0 < high - low < SEED.high,
        lambda u, low, high: low + np.minimum(np.floor(u * (high - low + 1.0)), high - low),
    ),
}


class Distribution(NamedTuple):
    """Probability distribution of a varied value: its family and its arguments."""

    family: str
    arguments: tuple[float, ...]

    def quantiles(self, shares: Floats) -> Floats:
        """Return the quantiles (n,) at probabilities `shares` (n,) from 0 to 1."""
        return FAMILIES[self.family].quantile(np.asarray(shares, dtype=np.float64), *self.arguments)

    @property
    def levels(self) -> int:
        """Number of equally probable values of a discrete distribution; 0: continuous."""
        if self.family != "integer":
            return 0
        return int(self.arguments[1] - self.arguments[0]) + 1

    def __str__(self) -> str:
        return f"{self.family}({', '.join(f'{each:g}' for each in self.arguments)})"


def distribution_of(text: str, called: str) -> Distribution:
    """Parse a distribution from a text such as `uniform(0, 1)`; `called` names it in messages.

    Raises ConfigError.
    """
    match = _CALL.fullmatch(text)
    family = FAMILIES.get(match[1]) if match else None
    if match is None or family is None:
        known = ", ".join(f"{name}({each.arguments})" for name, each in FAMILIES.items())
        raise ConfigError(f"{called}: {text.strip()}: allowed: {known}")
    try:
        given = tuple(float(each.replace("_", "")) for each in match[2].split(","))
    except ValueError:
        given = ()
    wanted = family.arguments.count(",") + 1
    if len(given) != wanted or not all(map(math.isfinite, given)) or not family.is_sound(*given):
        raise ConfigError(
            f"{called}: {text.strip()}: allowed: {match[1]}({family.arguments}) with {family.allowed}"
        )
    return Distribution(match[1], given)


def clopper_pearson(failed: int, count: int) -> tuple[float, float]:
    """Return the 95 % confidence interval of failed/count, after Clopper and Pearson (1934); `count` ≥ 1."""
    from scipy.special import betaincinv  # scipy.stats takes three times as long to import

    low = float(betaincinv(failed, count - failed + 1, 0.025)) if failed else 0.0
    high = float(betaincinv(failed + 1, count - failed, 0.975)) if failed < count else 1.0
    return low, high

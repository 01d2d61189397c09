"""Confidence interval of a share of failures."""

from __future__ import annotations


def clopper_pearson(failed: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share after Clopper and Pearson (1934); `count` is 1 or more."""
    from scipy.special import betaincinv  # scipy.stats takes three times as long to import

    low = float(betaincinv(failed, count - failed + 1, 0.025)) if failed else 0.0
    high = float(betaincinv(failed + 1, count - failed, 0.975)) if failed < count else 1.0
    return low, high

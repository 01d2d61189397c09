"""Numbers of an MF4 channel: conversions applied; invalid samples and value texts are none."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from liftgate_hil.formats.account import Account

NOT_NUMERIC = "not numeric; allowed: one number per sample"
NO_NUMBERS = "no numbers, only value texts or invalid samples; allowed: one number per sample"


class ChannelValues(NamedTuple):
    """Samples of a channel, and which of them are numbers."""

    values: NDArray[np.float64]  # (n,), in the channel's unit
    there: NDArray[np.bool_]  # (n,), false: invalid by the file's own word, or a text

    @property
    def numbers(self) -> NDArray[np.float64]:
        """Samples (n,), NaN where there is no number."""
        return self.values if self.there.all() else np.where(self.there, self.values, np.nan)


def values_of(signal: Any, account: Account) -> ChannelValues | None:
    """Return the numbers of a signal that asammdf has read raw; None if it is not numeric.

    The account is told of integers that no float holds.

    A conversion is applied. What it turns into a text (`Init` of a scaled angle) is no number, except of a state,
    whose raw numbers stand for the texts.
    """
    samples, conversion = np.asarray(signal.samples), signal.conversion
    there = np.ones(len(samples), dtype=bool)
    if samples.ndim != 1 or samples.dtype.names:
        return None
    if conversion is not None and not is_state(conversion, signal.unit):
        converted = np.asarray(conversion.convert(samples, as_object=True))
        if converted.ndim == 1 and converted.dtype.kind in "SUO":
            listed = converted.tolist()
            there = np.array([not isinstance(each, bytes | str) for each in listed], dtype=bool)
            if samples.dtype.kind not in "fiub" and not there.any():
                return None
            converted = np.array([0.0 if isinstance(each, bytes | str) else float(each) for each in listed])
        samples = converted
    if samples.ndim != 1 or samples.dtype.kind not in "fiub":
        return None
    if signal.invalidation_bits is not None:
        there &= ~np.asarray(signal.invalidation_bits, dtype=bool)
    return ChannelValues(account.floats_of(signal.name, samples), there)


def is_state(conversion: Any, unit: str) -> bool:
    """Whether value texts name the states of a channel, by raw numbers from 0 or 1 on, instead of single values.

    A state has no unit, and no other number is converted.
    """
    from asammdf.blocks import v4_constants as constants

    kinds = {constants.CONVERSION_TYPE_TABX: "val_{}", constants.CONVERSION_TYPE_RTABX: "lower_{}"}
    if unit or conversion.conversion_type not in kinds:
        return False
    blocks = conversion.referenced_blocks or {}
    default = blocks.get("default_addr")
    if not (default is None or isinstance(default, bytes) or _is_identity(default)):
        return False
    count = sum(name.startswith("text_") for name in blocks)
    texts = [blocks[f"text_{place}"] for place in range(count)]
    raw = [conversion[kinds[conversion.conversion_type].format(place)] for place in range(count)]
    return bool(raw) and min(raw) <= 1 and all(isinstance(text, bytes) for text in texts)


def _is_identity(conversion: Any) -> bool:
    """Whether a conversion leaves numbers as they are."""
    from asammdf.blocks import v4_constants as constants

    kind = conversion.conversion_type
    is_linear = kind == constants.CONVERSION_TYPE_LIN and (conversion.a, conversion.b) == (1, 0)
    return kind == constants.CONVERSION_TYPE_NON or is_linear

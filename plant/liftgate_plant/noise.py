"""Repeatable noise without hidden state: a hash of (seed, number, channel) through Box and Muller.

The same run gives the same noise, on every clock, compiled or not. Hash: C. Wellons' `lowbias32`, written so
that it gives the same bits in Python's unbounded integers and in 64-bit machine integers.
"""

from __future__ import annotations

import math

from liftgate_plant.compiler import compilable, outlined

_MASK = 0xFFFFFFFF


@compilable
def mix(x: int) -> int:
    """A 32-bit integer hash."""
    x = x & _MASK
    x = ((x ^ (x >> 16)) * 0x7FEB352D) & _MASK
    x = ((x ^ (x >> 15)) * 0x846CA68B) & _MASK
    return x ^ (x >> 16)


@compilable
def disturbance(deviation: float, seed: int, tick: int, channel: int) -> float:
    """Normal noise of that standard deviation; none costs nothing."""
    if deviation == 0.0:
        return 0.0
    return deviation * gaussian(seed, tick, channel)


@compilable
def key_of(seed: int, number: int, channel: int) -> int:
    """What the random number of that number (a tick, an edge, a pole) and channel is made of."""
    return mix(mix(mix(seed) + number) + (number >> 32) + 0x9E3779B9 * channel)


@compilable
def uniform(seed: int, number: int, channel: int) -> float:
    """A random number between 0 and 1, evenly distributed."""
    return (mix(key_of(seed, number, channel)) + 0.5) / 4294967296.0


@outlined
def gaussian(seed: int, number: int, channel: int) -> float:
    """A standard normal random number."""
    key = key_of(seed, number, channel)
    u = (mix(key) + 1.0) / 4294967296.0
    v = mix(key ^ 0x5BF03635) / 4294967296.0
    return math.sqrt(-2.0 * math.log(u)) * math.cos(2.0 * math.pi * v)

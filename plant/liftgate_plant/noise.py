"""Repeatable noise without hidden state: a hash of (seed, number, channel) and the Box–Muller transform.

The same run has the same noise, on every clock, compiled or not. Hash: C. Wellons' `lowbias32`, written so that it
gives the same bits in Python's unbounded integers and in 64-bit machine integers.
"""

from __future__ import annotations

import math

from liftgate_compiler import compilable, outlined

_MASK = 0xFFFFFFFF


@compilable
def mix(x: int) -> int:
    """Return the hash of a 32-bit integer."""
    x = x & _MASK
    x = ((x ^ (x >> 16)) * 0x7FEB352D) & _MASK
    x = ((x ^ (x >> 15)) * 0x846CA68B) & _MASK
    return x ^ (x >> 16)


@compilable
def disturbance(deviation: float, seed: int, tick: int, channel: int) -> float:
    """Return normal noise of a standard deviation, a pure hash of the other arguments; 0.0 for a deviation 0."""
    if deviation == 0.0:
        return 0.0
    return deviation * gaussian(seed, tick, channel)


@compilable
def key_of(seed: int, number: int, channel: int) -> int:
    """Return the hash from which a random number is made, by number (a tick, an edge, a pole) and channel."""
    return mix(mix(mix(seed) + number) + (number >> 32) + 0x9E3779B9 * channel)


@compilable
def uniform(seed: int, number: int, channel: int) -> float:
    """Return a number uniformly distributed between 0 and 1: a pure hash of seed, number and channel."""
    return (mix(key_of(seed, number, channel)) + 0.5) / 4294967296.0


@outlined
def gaussian(seed: int, number: int, channel: int) -> float:
    """Return a standard normally distributed number: a pure hash of seed, number and channel."""
    key = key_of(seed, number, channel)
    u = (mix(key) + 1.0) / 4294967296.0
    v = mix(key ^ 0x5BF03635) / 4294967296.0
    return math.sqrt(-2.0 * math.log(u)) * math.cos(2.0 * math.pi * v)

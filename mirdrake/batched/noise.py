"""Noise from a counter-based generator: a number depends on seed, car, step and channel only.

Every number is the hash of its counter (the finaliser of SplitMix64: G. L. Steele, D. Lea, C. H. Flood, Fast splittable
pseudorandom number generators, OOPSLA 2014), so that it is the same in any order of cars and steps, and with any number
of threads. Two hashes give a normal number (G. E. P. Box, M. E. Muller, Ann. Math. Statist. 29, 1958).

The functions take numbers when they are compiled, and arrays of uint64 from Python.
"""

import math
from typing import Any

import numpy as np

_GAMMA = np.uint64(0x9E3779B97F4A7C15)  # golden ratio, odd
_FIRST, _SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_A, _B, _C, _ONE, _ELEVEN = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(1), np.uint64(11)
_SCALE = 1.0 / 9007199254740992.0  # 2^-53
_TURN = 2.0 * math.pi


def mix(value: Any) -> Any:
    """Return the hash of a uint64, as a uint64."""
    value = (value ^ (value >> _A)) * _FIRST
    value = (value ^ (value >> _B)) * _SECOND
    return value ^ (value >> _C)


def counter_hash(seed: Any, car: Any, step: Any, channel: Any) -> Any:
    """Return the hash of a counter of four uint64."""
    # The constant is added to every word, as mix maps zero to zero. Hashing word by word keeps their order significant.
    value = mix(seed + _GAMMA)
    value = mix(value ^ (car + _GAMMA))
    value = mix(value ^ (step + _GAMMA))
    return mix(value ^ (channel + _GAMMA))


def uniform(hashed: Any) -> Any:
    """Return a number in (0, 1) for a hash."""
    # The upper 53 bits fit a double exactly; half a unit keeps zero out, whose logarithm is infinite.
    return ((hashed >> _ELEVEN) + 0.5) * _SCALE


def normal(seed: Any, car: Any, step: Any, channel: Any) -> Any:
    """Return a number of the standard normal distribution for a counter."""
    first = counter_hash(seed, car, step, channel)
    second = mix(first + _GAMMA)
    return np.sqrt(-2.0 * np.log(uniform(first))) * np.cos(_TURN * uniform(second))


NOISE_PARTS = (mix, counter_hash, uniform, normal)
"""Functions that :func:`normal` calls, and itself."""

"""Noise that depends on nothing but the seed, the sensor's name and the number of the sample.

A counter-based generator (Philox 4x64, Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3") gives the
numbers of sample k directly. So no sensor keeps a generator: a Context holds all there is to repeat a run, a sample
drawn twice is the same, and one more sensor changes nothing about the others.
"""

import hashlib

import numpy as np


def noise_stream(seed: int, name: str) -> int:
    """The random stream of a sensor: the first 128 bits of SHA-256 of ``seed/name``.

    Args:
        seed: of the whole diagram.
        name: of the sensor, for example ``ego.imu``.
    """
    return int.from_bytes(hashlib.sha256(f"{seed}/{name}".encode()).digest()[:16], "little")


def sample_noise(stream: int, index: int) -> np.random.Generator:
    """The generator of one sample; up to 2^192 numbers until it would run into the next one.

    Args:
        stream: from :func:`noise_stream`.
        index: number of the sample, 0 or more.
    """
    return np.random.Generator(np.random.Philox(key=stream, counter=index << 192))

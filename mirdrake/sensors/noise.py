"""Noise that depends only on the seed, the sensor's name and the number of the sample.

A counter-based generator (Philox 4x64, Salmon et al. 2011, "Parallel random numbers: as easy as 1, 2, 3") gives the
numbers of sample k directly. A sensor therefore keeps no generator: a Context is enough to repeat a run, a sample that
is drawn twice is the same, and another sensor does not change the noise of the others. Slowly varying errors (random
walk, bias instability) are sums over samples; they are states of the sensor in the Context.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from mirdrake.sensors.noise_spec import NoiseSpec

Array = NDArray[np.float64]

PLATEAU = 0.6174
"""[-] Highest Allan deviation of a first-order Gauss-Markov process over its standard deviation, at 1.89 x its
correlation time: √(2/u (1 - (3 - 4 exp(-u) + exp(-2 u)) / (2 u))) at u = 1.89; IEEE Std 952-1997, annex C."""


def noise_stream(seed: int, name: str) -> int:
    """Return the random stream of a sensor: the first 128 bits of SHA-256 of ``seed/name``.

    Args:
        seed: seed of the whole diagram.
        name: name of the sensor, for example ``ego.imu``.
    """
    # Python's own hash of a text differs from process to process; SHA-256 does not.
    return int.from_bytes(hashlib.sha256(f"{seed}/{name}".encode()).digest()[:16], "little")


def substream(stream: int, name: str) -> int:
    """Return another, independent stream of the same sensor."""
    return noise_stream(stream, name)


def sample_noise(stream: int, index: int) -> np.random.Generator:
    """Return the generator of one sample; it gives up to 2^192 numbers before it meets that of the next sample.

    Args:
        stream: stream from :func:`noise_stream`.
        index: number of the sample, 0 or more.
    """
    # Each sample gets the upper 64 bits of the 256-bit counter, so the numbers of two samples never overlap.
    return np.random.Generator(np.random.Philox(key=stream, counter=index << 192))


def is_lost(stream: int, index: int, dropout: float) -> bool:
    """Return whether a sample is lost, with the probability `dropout`."""
    # A stream of its own: a dropout probability of a sensor does not change the noise of its other samples.
    return dropout > 0.0 and bool(sample_noise(substream(stream, "dropout"), index).random() < dropout)


@dataclass(frozen=True)
class Noise:
    """The errors of n elements, sampled at a rate.

    Attributes:
        white: standard deviation of each sample (n).
        bias: standard deviation of the constant (n).
        drift: standard deviation of the bias instability, a first-order Gauss-Markov process (n).
        memory: correlation of that process from one sample to the next (n) [-].
        walk: standard deviation of one step of the random walk (n).
    """

    white: Array
    bias: Array
    drift: Array
    memory: Array
    walk: Array

    @classmethod
    def of(cls, specs: Sequence[NoiseSpec], rate: float) -> Self:
        """Return the noise of data-sheet figures (n), sampled at a rate [Hz]."""
        return cls(
            white=np.array([spec.sample_deviation(rate) for spec in specs]),
            bias=np.array([spec.bias for spec in specs]),
            drift=np.array([spec.instability / PLATEAU for spec in specs]),
            # A Gauss-Markov process sampled at intervals T has the correlation exp(-T / Tc) from sample to sample.
            memory=np.array([np.exp(-1.0 / (rate * spec.correlation)) for spec in specs]),
            # Variance of a random walk grows with time: each of `rate` steps per second adds walk² / rate.
            walk=np.array([spec.walk / np.sqrt(rate) for spec in specs]),
        )

    @classmethod
    def plain(cls, deviations: Sequence[float]) -> Self:
        """Return white noise of these standard deviations (n)."""
        white = np.array(deviations, dtype=float)
        return cls(white, *(np.zeros(white.size) for _ in range(4)))

    def constant(self, stream: int) -> Array:
        """Return the constant part of the error (n)."""
        return self.bias * sample_noise(substream(stream, "bias"), 0).standard_normal(self.bias.size)

    def start(self, stream: int) -> Array:
        """Return the slowly varying errors at the first sample: random walk and drift (2 n), or (0) without them."""
        if not (self.walk.any() or self.drift.any()):
            return np.zeros(0)
        # Drift starts from its stationary distribution, not from zero, or the first Tc seconds would be too good.
        first = sample_noise(substream(stream, "drift"), 0).standard_normal(self.drift.size)
        return np.concatenate((np.zeros(self.walk.size), self.drift * first))

    def step(self, stream: int, index: int, state: Array) -> tuple[Array, Array]:
        """Return the error of one sample without its constant part (n), and the slowly varying errors of the next one.

        Args:
            stream: stream from :func:`noise_stream`.
            index: number of the sample.
            state: slowly varying errors of this sample.
        """
        n = self.white.size
        if not (state.size or self.white.any()):
            return np.zeros(n), state
        generator = sample_noise(stream, index)
        error: Array = self.white * generator.standard_normal(n)
        if not state.size:
            return error, state
        step = generator.standard_normal(2 * n)
        # Scaled so that the variance of the process stays drift²: m² drift² + (1 - m²) drift² = drift².
        kick = self.drift * np.sqrt(1.0 - self.memory**2)
        following = np.concatenate((state[:n] + self.walk * step[:n], self.memory * state[n:] + kick * step[n:]))
        # The error uses the state at this sample; `following` is that of the next one.
        return error + state[:n] + state[n:], following

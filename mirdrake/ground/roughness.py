"""Random roughness of roads by ISO 8608, as a field over the plane.

ISO 8608 describes the profile of a straight track by its one-sided spectral density Gd(n) = Gd(n0) (n / n0)^-2 with the
spatial frequency n in cycles/m and n0 = 0.1 cycles/m. Left and right wheels need two profiles with the right coherence;
an isotropic field has it (K. M. A. Kamash, J. D. Robson, The application of isotropy in road surface modelling, J.
Sound and Vibration 57, 1978). Its two-dimensional density S(k) gives each straight track the two-sided density

    Gd(n) / 2 = ∫ S(√(n² + m²)) dm,     so that     S(k) = Gd(n0) n0² / (4 k³),

as ∫ (n² + m²)^(-3/2) dm = 2 / n². The coherence of two tracks at the distance B is 2πnB K1(2πnB), with the modified
Bessel function K1; the tests check it.

The field is the sum of two periodic grids with independent random phases, one for long and one for short waves. The
second one is rotated, so that the sum does not repeat along a road.
"""

from dataclasses import dataclass
from math import pi
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mirdrake.ground.terrain import Grid

RoughnessClass = Literal["A", "B", "C", "D", "E"]

ROUGHNESS = {"A": 16e-6, "B": 64e-6, "C": 256e-6, "D": 1024e-6, "E": 4096e-6}
"""Geometric means of Gd(n0) by class of ISO 8608 [m³]."""

REFERENCE_FREQUENCY = 0.1
"""n0 [cycles/m]."""

LONGEST, SPLIT, SHORTEST = 0.01, 0.25, 6.0
"""Smallest frequency, frequency between the two grids, and largest frequency [cycles/m]. ISO 8608 extends to 10
cycles/m; tyres envelop waves that are shorter than their contact patch."""

# At least three nodes per wavelength; the fields repeat after 512 m (long waves) and 51 m (short waves).
_LONG_CELL, _SHORT_CELL, _NODES = 0.5, 0.05, 1024
_ROTATION = pi * (3.0 - 5.0**0.5)  # golden angle: tan is irrational, and far from ratios of small numbers [rad]


@dataclass(frozen=True)
class Roughness:
    """Isotropic roughness.

    Attributes:
        density: Gd(n0) [m³], for example of :data:`ROUGHNESS`.
        seed: seed of the random phases.
    """

    density: float
    seed: int = 0

    def grids(self) -> tuple[Grid, Grid]:
        """Return the layers of long and of short waves."""
        random = np.random.default_rng(self.seed)
        long = _field(random, self.density, _LONG_CELL, LONGEST, SPLIT)
        short = _field(random, self.density, _SHORT_CELL, SPLIT, SHORTEST)
        return (
            Grid(long, _LONG_CELL, periodic=True),
            Grid(short, _SHORT_CELL, yaw=_ROTATION, periodic=True),
        )


def _field(random: np.random.Generator, density: float, cell: float, low: float, high: float) -> NDArray[np.float64]:
    """Return a periodic Gaussian field with the density S(k) between two frequencies [cycles/m].

    White noise of variance 1 has a discrete Fourier transform of variance N²; a component of the field needs the
    variance S(k) dk² N⁴, with dk = 1 / (N cell).
    """
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(_NODES, cell), np.fft.rfftfreq(_NODES, cell), indexing="ij"))
    inside = (k >= low) & (k < high)
    spectrum = np.zeros_like(k)
    spectrum[inside] = density * REFERENCE_FREQUENCY**2 / (4.0 * k[inside] ** 3)
    # Filtered white noise instead of random phases of an own spectrum: the symmetry of a real field comes for free.
    white = np.fft.rfft2(random.standard_normal((_NODES, _NODES)))
    gain = np.sqrt(spectrum) * (1.0 / (_NODES * cell)) * _NODES
    return np.fft.irfft2(white * gain, s=(_NODES, _NODES))

"""Fourier coefficients of held controls and sampled measurements."""

import numpy as np

from mirdrake.tuning.models import Floats


def fourier_line(samples: Floats, period: float, frequency: float) -> complex:
    """Return the complex amplitude of a frequency in samples that span a whole number of its cycles.

    Args:
        samples: shape (n,), one every `period`.
        period: [s].
        frequency: [rad/s].

    Returns:
        c with ``samples ≈ Re(c exp(j frequency t))``, where t is 0 at the first sample.
    """
    time = np.arange(len(samples)) * period
    return complex(2.0 / len(samples) * np.sum(samples * np.exp(-1j * frequency * time)))


def fitted_line(samples: Floats, period: float, frequency: float, *, harmonics: int = 5) -> complex:
    """Return the amplitude by least squares with a constant and harmonics, for cycles of any length."""
    phase = np.arange(len(samples)) * period * frequency
    order = np.arange(1, harmonics + 1)
    # Least squares instead of a sum: the window need not be a whole number of periods, and the constant is not a bias.
    columns = np.hstack([np.ones((len(samples), 1)), np.cos(np.outer(phase, order)), np.sin(np.outer(phase, order))])
    weights = np.linalg.lstsq(columns, samples, rcond=None)[0]
    return complex(weights[1], -weights[1 + harmonics])

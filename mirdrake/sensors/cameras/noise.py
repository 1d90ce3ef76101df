"""Fast noise of image sensors: random bits select equally likely quantiles of the normal distribution.

The noise depends only on the stream and the number of the sample. The bits are those of SFC64, seeded with both, which
takes a third of the time of Philox. A colour picture needs a million numbers. They are taken from a store of four
million numbers of the camera, from another position for each picture: to compute them would take longer than the
simulation between two pictures.
"""

from functools import cache, lru_cache

import numpy as np
import scipy
from numpy.typing import NDArray

from mirdrake.sensors.cameras.mounts import DepthCameraMount

Colors = NDArray[np.uint8]
Depths = NDArray[np.float32]

STORE = 2**22
"""Size of the store of random numbers of a camera; the noise of larger pictures is computed for each picture."""

_LEVELS = 2**16  # of the uniform random numbers that noise is made of


def color_noise(seen: Colors, noise: float, *, stream: int, index: int) -> Colors:
    """Return colours with white noise.

    Args:
        seen: rendered colours (height, width, 4); alpha is ignored.
        noise: standard deviation [of full scale].
        stream: stream from :func:`mirdrake.sensors.noise.noise_stream`.
        index: number of the sample.

    Returns:
        red, green, blue (height, width, 3), a copy.
    """
    out = np.empty((*seen.shape[:2], 3), dtype=np.uint8)
    if not noise:
        for channel in range(3):  # faster than all three at once, as the innermost loop of NumPy is then a long one
            out[:, :, channel] = seen[:, :, channel]
        return out
    levels = _levels(noise, stream, index, out.size).reshape(3, *seen.shape[:2])
    # int16: the sum of a colour and negative noise must not wrap around.
    sums = np.empty(seen.shape[:2], dtype=np.int16)
    for channel in range(3):
        np.add(levels[channel], seen[:, :, channel], out=sums)
        np.clip(sums, 0, 255, out=sums)
        out[:, :, channel] = sums
    return out


def depth_noise(seen: Depths, mount: DepthCameraMount, *, stream: int, index: int) -> Depths:
    """Return the output of a depth sensor [m]: noise, limits and resolution applied.

    Args:
        seen: rendered depths: 0 nearer than the limits and infinite beyond them (height, width).
        mount: noise, limits and steps.
        stream: stream from :func:`mirdrake.sensors.noise.noise_stream`.
        index: number of the sample.
    """
    spec, step, inverse = mount.depth_noise, mount.depth_resolution, mount.inverse_depth_resolution
    if not (spec.base or spec.growth or step or inverse):
        return seen.copy()
    valid = np.isfinite(seen) & (seen > 0.0)
    # Invalid depths get a number for the computation and are put back at the end.
    z = np.where(valid, seen, np.float32(mount.depth_near))
    if spec.base or spec.growth:
        deviation = np.float32(spec.base) + np.float32(spec.growth) * np.square(z - np.float32(spec.start))
        z += deviation * np.take(_quantiles(), _bits(stream, index, z.size)).reshape(z.shape)
        np.clip(z, np.float32(mount.depth_near), np.float32(mount.depth_far), out=z)
    # Disparity is proportional to 1/z and is rounded to whole steps; at least one step, or z would be infinite.
    if inverse:
        z = 1.0 / (np.float32(inverse) * np.maximum(np.rint(1.0 / (z * np.float32(inverse))), np.float32(1.0)))
    if step:
        z = np.float32(step) * np.rint(z / np.float32(step))
    return np.where(valid, z, seen)


def _levels(noise: float, stream: int, index: int, count: int) -> NDArray[np.int16]:
    """Return the white noise of a sample in grey levels."""
    # At most half of the store, so that there are many different positions for a picture.
    if 2 * count > STORE:
        return _grey(noise, stream, index, count)
    begin = int(np.random.SFC64([stream, index]).random_raw() % (STORE - count + 1))
    return _store(noise, stream)[begin : begin + count]


@lru_cache(maxsize=16)
def _store(noise: float, stream: int) -> NDArray[np.int16]:
    return _grey(noise, stream, 2**64, STORE)  # a number that no sample has


def _grey(noise: float, stream: int, index: int, count: int) -> NDArray[np.int16]:
    table = np.rint(np.clip(255.0 * noise * _quantiles(), -255.0, 255.0)).astype(np.int16)
    levels: NDArray[np.int16] = table[_bits(stream, index, count)]
    return levels


def _bits(stream: int, index: int, count: int) -> NDArray[np.uint16]:
    """Return uniform random numbers of 16 bits."""
    # Four numbers of 16 bits from each 64-bit word.
    return np.random.SFC64([stream, index]).random_raw(-(-count // 4)).view(np.uint16)[:count]


@cache
def _quantiles() -> Depths:
    """Return equally likely quantiles of the standard normal distribution."""
    values = scipy.special.ndtri((np.arange(_LEVELS) + 0.5) / _LEVELS)
    # Scaled to a standard deviation of exactly 1, which the cut tails would reduce.
    quantiles: Depths = (values / values.std()).astype(np.float32)
    quantiles.setflags(write=False)
    return quantiles

"""Lens distortion: a distorted picture is resampled from a larger one rendered without distortion."""

from math import ceil, tan
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from mirdrake.sensors.cameras.mounts import PictureMount


class LensMap:
    """Position of each pixel of a distorted picture in the rendered picture.

    Both have the same focal length. The rendered picture extends one pixel beyond the view of the lens, so that no
    pixel of the distorted one is empty. Colours are interpolated between four pixels; depths and labels are of the
    nearest one.

    Args:
        mount: size, field of view and distortion.
    """

    def __init__(self, mount: PictureMount) -> None:
        assert mount.distortion is not None
        focal = 0.5 * mount.width / tan(0.5 * mount.horizontal_fov)
        columns, rows = np.meshgrid(np.arange(mount.width, dtype=float), np.arange(mount.height, dtype=float))
        across: NDArray[np.float64] = (columns - 0.5 * (mount.width - 1)) / focal
        down: NDArray[np.float64] = (rows - 0.5 * (mount.height - 1)) / focal
        x, y = mount.distortion.undistort(across, down)
        self.shape = (mount.height, mount.width)
        self.focal = focal
        # An odd size with one pixel of border: the four neighbours of every point exist, and a pixel is at the centre.
        self.width, self.height = (2 * ceil(focal * np.abs(side).max() + 1.0) + 1 for side in (x, y))
        u, v = (focal * x + 0.5 * (self.width - 1)).ravel(), (focal * y + 0.5 * (self.height - 1)).ravel()
        self._nearest = (np.rint(v) * self.width + np.rint(u)).astype(np.intp)
        left, upper = np.floor(u).astype(np.intp), np.floor(v).astype(np.intp)
        right, lower = u - left, v - upper
        first = upper * self.width + left
        index = np.stack((first, first + 1, first + self.width, first + self.width + 1), axis=1)
        weights = ((1.0 - right) * (1.0 - lower), right * (1.0 - lower), (1.0 - right) * lower, right * lower)
        begins = np.arange(0, 4 * u.size + 1, 4)
        # Bilinear interpolation as a sparse matrix: four weights per pixel, computed once for all pictures.
        self._mix = scipy.sparse.csr_array(
            (np.stack(weights, axis=1).ravel().astype(np.float32), index.ravel(), begins),
            shape=(u.size, self.width * self.height),
        )

    def colors(self, drawn: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the colours of the distorted picture from those rendered (self.height, self.width, n)."""
        channels = drawn.shape[2]
        mixed = self._mix @ drawn.reshape(-1, channels).astype(np.float32)
        # Half a level, because the conversion to uint8 truncates.
        mixed += 0.5
        colors: NDArray[np.uint8] = mixed.astype(np.uint8).reshape(*self.shape, channels)
        return colors

    def nearest(self, drawn: NDArray[Any]) -> NDArray[Any]:
        """Return depths or labels of the distorted picture from those rendered (self.height, self.width)."""
        picture: NDArray[Any] = drawn.reshape(-1)[self._nearest].reshape(self.shape)
        return picture

"""Lens distortion after Brown and Conrady, with the coefficients that OpenCV and ROS use.

A point in the direction x = right/forward, y = down/forward of the camera appears at

    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)
    y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y,    r² = x² + y²

Source: D. C. Brown, "Decentering distortion of lenses", Photogrammetric Engineering 32 (1966) 444-462.
"""

from math import radians, tan

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mirdrake.core.yaml_io import Schema

Array = NDArray[np.float64]

WIDEST = radians(85.0)
"""Largest angle from the middle of a distorted picture to its border [rad]; the picture is rendered on a plane."""

_STEPS, _EXACT = 40, 1e-9


class LensSpec(Schema):
    """Distortion coefficients [-]; all zero is a pinhole camera."""

    k1: float = Field(default=0.0, ge=-10, le=10, description="[-] radial, negative for barrel distortion")
    k2: float = Field(default=0.0, ge=-100, le=100, description="[-] radial")
    p1: float = Field(default=0.0, ge=-1, le=1, description="[-] tangential")
    p2: float = Field(default=0.0, ge=-1, le=1, description="[-] tangential")
    k3: float = Field(default=0.0, ge=-100, le=100, description="[-] radial")

    def distort(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the picture coordinates x', y' [-] of directions x, y [-]."""
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return (
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )

    def undistort(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the directions [-] of picture coordinates x', y' [-], by Newton's method.

        Raises:
            ValueError: a coordinate has no direction, or the distortion is not monotonic up to it.
        """
        u, v = np.array(x, dtype=float), np.array(y, dtype=float)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            for _ in range(_STEPS):
                seen_x, seen_y = self.distort(u, v)
                off_x, off_y = seen_x - x, seen_y - y
                xx, xy, yy = self._slopes(u, v)
                # Newton's method with the inverse of the 2 x 2 Jacobian, which is symmetric for this model.
                det = xx * yy - xy * xy
                u, v = u - (yy * off_x - xy * off_y) / det, v - (xx * off_y - xy * off_x) / det
            seen_x, seen_y = self.distort(u, v)
            # Divergent coordinates are NaN or far off; both fail this comparison.
            good = np.hypot(seen_x - x, seen_y - y) < _EXACT * (1.0 + np.hypot(x, y))
            # A polynomial may turn back: the Jacobian must be positive definite all
            # the way from the centre to the point.
            for part in (0.25, 0.5, 0.75, 1.0):
                xx, xy, yy = self._slopes(part * u, part * v)
                good &= (xx * yy - xy * xy > 0.0) & (xx + yy > 0.0)
        if not np.all(good):
            raise ValueError("the distortion is not invertible within the picture; use smaller coefficients")
        return u, v

    def _slopes(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Return dx'/dx, dx'/dy = dy'/dx and dy'/dy."""
        r2 = x * x + y * y
        radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        bend = 2.0 * (self.k1 + r2 * (2.0 * self.k2 + r2 * 3.0 * self.k3))  # of radial, by r² / 2
        return (
            radial + x * x * bend + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
            x * y * bend + 2.0 * self.p1 * x + 2.0 * self.p2 * y,
            radial + y * y * bend + 6.0 * self.p1 * y + 2.0 * self.p2 * x,
        )


def view_of(lens: LensSpec, *, width: int, height: int, horizontal_fov: float) -> tuple[float, float]:
    """Return the largest |right/forward| and |down/forward| [-] within a picture.

    Args:
        lens: its distortion.
        width: width of the picture [pixel].
        height: height of the picture [pixel].
        horizontal_fov: without the lens [rad].

    Raises:
        ValueError: the distortion cannot be inverted everywhere in the picture.
    """
    edge = tan(0.5 * horizontal_fov)
    # 33 x 33 points: the extreme view need not be at a corner of the picture if the distortion is strong.
    across, down = np.meshgrid(np.linspace(-edge, edge, 33), np.linspace(-edge, edge, 33) * height / width)
    x, y = lens.undistort(across, down)
    return float(np.abs(x).max()), float(np.abs(y).max())


def check_lens(lens: LensSpec, *, width: int, height: int, horizontal_fov: float) -> None:
    """Check that a picture [pixel] can be rendered with a lens.

    Raises:
        ValueError: the lens cannot be rendered; the message has the reason.
    """
    if max(view_of(lens, width=width, height=height, horizontal_fov=horizontal_fov)) > tan(WIDEST):
        raise ValueError("the lens covers more than 170 deg; use smaller distortion coefficients")

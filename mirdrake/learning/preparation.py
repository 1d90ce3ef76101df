"""Cropping and resizing of pictures, the same in data sets and inside of exported networks."""

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from mirdrake.core.errors import ConfigError
from mirdrake.core.yaml_io import Schema

Matrix = NDArray[np.float32]


class CropSpec(Schema):
    """Pixels that are cut off each side of a picture."""

    top: int = Field(0, ge=0, description="[pixel]")
    bottom: int = Field(0, ge=0, description="[pixel]")
    left: int = Field(0, ge=0, description="[pixel]")
    right: int = Field(0, ge=0, description="[pixel]")


def area_matrix(size: int, target: int) -> Matrix:
    """Return the matrix (target, size) that resizes a line of pixels by averaging over areas.

    Each target pixel is the mean of the source over its interval, with partial pixels weighted by their overlap. Every
    row sums to 1.
    """
    # Bounds of the target pixels in source pixels; the overlap of both intervals is the weight.
    edges = np.arange(target + 1) * (size / target)
    low, high = edges[:-1, np.newaxis], edges[1:, np.newaxis]
    pixels = np.arange(size)
    overlap = np.clip(np.minimum(high, pixels + 1) - np.maximum(low, pixels), 0.0, None)
    matrix: Matrix = (overlap / overlap.sum(axis=1, keepdims=True)).astype(np.float32)
    return matrix


class Preparation:
    """Cropping, then resizing, of pictures of one size.

    Args:
        width: of the pictures [pixel].
        height: of the pictures [pixel].
        crop: what is cut off.
        size: width and height of the result [pixel]; None: as cropped.

    Attributes:
        given: height and width of the pictures.
        shape: height and width of the result.

    Raises:
        ConfigError: nothing of the picture is left.
    """

    def __init__(self, width: int, height: int, crop: CropSpec, size: tuple[int, int] | None = None) -> None:
        self.given = (height, width)
        self.rows = slice(crop.top, height - crop.bottom)
        self.columns = slice(crop.left, width - crop.right)
        cropped = (self.rows.stop - self.rows.start, self.columns.stop - self.columns.start)
        if min(cropped) < 1:
            raise ConfigError(f"crop: nothing is left of pictures of {width} x {height} pixels")
        self.cropped = cropped
        self.shape = cropped if size is None else (size[1], size[0])

    @cached_property
    def row_matrix(self) -> Matrix:
        """Matrix that resizes the columns of a cropped picture."""
        return area_matrix(self.cropped[0], self.shape[0])

    @cached_property
    def column_matrix(self) -> Matrix:
        """Matrix that resizes the rows of a cropped picture."""
        return area_matrix(self.cropped[1], self.shape[1])

    def __call__(self, pixels: NDArray[Any]) -> NDArray[np.uint8]:
        """Return a prepared picture uint8 (height, width, 3).

        Raises:
            ConfigError: the picture has another size.
        """
        if pixels.shape[:2] != self.given:
            have, want = pixels.shape, self.given
            raise ConfigError(f"a picture has {have[1]} x {have[0]} pixels, the others {want[1]} x {want[0]}")
        part = pixels[self.rows, self.columns, :3]
        if self.shape == self.cropped:
            return np.ascontiguousarray(part)
        # In single precision and rounded as in the exported graph, so that training and driving see equal pictures.
        values = np.tensordot(self.row_matrix, part.astype(np.float32), axes=(1, 0))
        values = np.matmul(self.column_matrix, values)
        return np.asarray(np.rint(values), dtype=np.uint8)

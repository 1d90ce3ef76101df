"""Draw the ground textures of the worlds: run it to make the JPG files beside it again.

Own work, made of filtered noise only. A texture repeats without a seam, because its noise is filtered on a torus (FFT).
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Array = NDArray[np.float64]
SIZE = 512
FOLDER = Path(__file__).resolve().parent


def noise(rng: np.random.Generator, *, coarse: float, fine: float) -> Array:
    """Periodic noise of zero mean and unit deviation, with details between two sizes [pixels]."""
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(SIZE), np.fft.fftfreq(SIZE)))
    band = np.exp(-((f * fine) ** 2)) * (1.0 - np.exp(-((f * coarse) ** 2)))
    value = np.fft.ifft2(np.fft.fft2(rng.standard_normal((SIZE, SIZE))) * band).real
    return np.asarray((value - value.mean()) / value.std())


def shade(base: tuple[int, int, int], brightness: Array, tint: Array | None = None) -> Array:
    """Colour times brightness (1 = base); `tint` moves red up and blue down."""
    image = np.array(base, dtype=float) * brightness[..., None]
    if tint is not None:
        image *= 1.0 + tint[..., None] * np.array([1.0, 0.2, -0.8])
    return image


def save(name: str, image: Array, *, quality: int = 80) -> None:
    """Write an image, 0 .. 255, as JPG beside this file."""
    pixels = np.clip(image, 0.0, 255.0).astype(np.uint8)
    Image.fromarray(pixels).save(FOLDER / f"{name}.jpg", quality=quality, optimize=True)


def asphalt(rng: np.random.Generator) -> Array:
    """Dark grey with light and dark stones of about 1 cm and faint patches (a tile is 4 m)."""
    stones = noise(rng, coarse=6.0, fine=2.0)
    speckle = np.where(stones > 1.6, 0.28, np.where(stones < -1.7, -0.22, 0.0))
    return shade((88, 88, 92), 1.0 + 0.07 * stones + speckle + 0.03 * noise(rng, coarse=90.0, fine=30.0))


def grass(rng: np.random.Generator) -> Array:
    """Green with blades, tufts and slightly dry spots (a tile is 6 m)."""
    blades, tufts = noise(rng, coarse=7.0, fine=2.2), noise(rng, coarse=40.0, fine=14.0)
    return shade((98, 118, 62), 1.0 + 0.12 * blades + 0.05 * tufts, 0.025 * noise(rng, coarse=80.0, fine=35.0))


def concrete(rng: np.random.Generator) -> Array:
    """Light grey with faint stains (a tile is 4 m)."""
    return shade(
        (158, 155, 148), 1.0 + 0.03 * noise(rng, coarse=6.0, fine=2.0) + 0.03 * noise(rng, coarse=120.0, fine=40.0)
    )


def gravel(rng: np.random.Generator) -> Array:
    """Grey-brown stones of a few centimetres (a tile is 3 m)."""
    stones = noise(rng, coarse=12.0, fine=5.0)
    return shade((142, 130, 112), 1.0 + 0.16 * stones + 0.05 * noise(rng, coarse=6.0, fine=2.0), 0.03 * stones)


def ice(rng: np.random.Generator) -> Array:
    """Pale blue with scratches (a tile is 8 m)."""
    return shade(
        (205, 222, 232), 1.0 + 0.025 * noise(rng, coarse=100.0, fine=30.0) + 0.015 * noise(rng, coarse=6.0, fine=2.0)
    )


def main() -> None:
    """Write all files."""
    for seed, draw in enumerate((asphalt, grass, concrete, gravel, ice)):
        save(draw.__name__, draw(np.random.default_rng(seed)))


if __name__ == "__main__":
    main()

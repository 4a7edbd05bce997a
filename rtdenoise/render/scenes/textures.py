"""Bitmap textures and sky maps made in numpy: linear RGB reflectance or radiance, `[H, W, 3]` float32.

Textures are rich in fine detail, which a denoiser has to learn to keep.
"""

from __future__ import annotations

import numpy as np

SIZE = 128  # pixels a side of a surface texture
SKY = (64, 128)  # latitude, longitude


def colour(rng: np.random.Generator, low: float = 0.08, high: float = 0.9) -> np.ndarray:
    """A random reflectance: hue free, saturation mostly moderate, value in [low, high]."""
    hue, saturation = rng.uniform(0, 6), rng.beta(1.2, 1.6)
    pure = np.clip(np.abs((hue + np.array([0, 4, 2])) % 6 - 3) - 1, 0, 1)
    return (rng.uniform(low, high) * (1 - saturation * (1 - pure))).astype(np.float32)


def plain(value) -> np.ndarray:
    """A texture of one colour, of the same size as all others."""
    return np.ones((SIZE, SIZE, 3), np.float32) * np.asarray(value, np.float32)


def fractal(rng: np.random.Generator, first: int = 4) -> np.ndarray:
    """[SIZE, SIZE] in [0, 1]: periodic value noise summed over octaves."""
    total = np.zeros((SIZE, SIZE))
    cells = first
    while cells <= SIZE // 2:
        grid = rng.uniform(-1, 1, (cells, cells))
        x = np.arange(SIZE) * cells / SIZE
        i, f = x.astype(int), x % 1
        f = f * f * (3 - 2 * f)
        rows = grid[i] * (1 - f)[:, None] + grid[(i + 1) % cells] * f[:, None]
        total += (rows[:, i] * (1 - f) + rows[:, (i + 1) % cells] * f) / cells**0.7
        cells *= 2
    low, high = np.quantile(total, [0.02, 0.98])
    return np.clip((total - low) / (high - low), 0, 1)


def _checker(rng):
    n = int(rng.choice([2, 4, 8, 16]))
    cell = np.arange(SIZE) * n // SIZE
    return ((cell[:, None] + cell[None]) % 2).astype(float)


def _stripes(rng):
    n, slope = int(rng.choice([3, 6, 12, 24])), int(rng.integers(-2, 3))
    x, y = np.meshgrid(np.arange(SIZE), np.arange(SIZE))
    return ((x * n + y * slope * n) / SIZE % 1 < rng.uniform(0.25, 0.75)).astype(float)


def _bricks(rng):
    rows, columns, joint = int(rng.choice([4, 8])), int(rng.choice([2, 4])), 0.08
    y, x = np.meshgrid(np.arange(SIZE) * rows / SIZE, np.arange(SIZE) * columns / SIZE, indexing="ij")
    x = x + 0.5 * (y.astype(int) % 2)
    stone = rng.uniform(0.5, 1, (rows, columns))[y.astype(int), x.astype(int) % columns]
    return np.where((y % 1 < joint * 1.5) | (x % 1 < joint), 0.0, stone)


def _dots(rng):
    n = int(rng.choice([3, 6, 10]))
    x = (np.arange(SIZE) * n / SIZE) % 1 - 0.5
    return (x[:, None] ** 2 + x[None] ** 2 < rng.uniform(0.06, 0.18)).astype(float)


def _print(rng):
    """Lines of random blocks, as printed text looks from afar."""
    blocks = np.repeat(np.repeat(rng.uniform(size=(SIZE // 8, SIZE // 2)) < 0.6, 8, 0), 2, 1).astype(float)
    blocks[np.arange(SIZE) % 8 >= 5] = 0
    return blocks


def _marble(rng):
    x = np.arange(SIZE) / SIZE * 2 * np.pi
    return 0.5 + 0.5 * np.sin(int(rng.integers(1, 5)) * x[None] + 9 * fractal(rng))


def _tiles(rng):
    n = int(rng.choice([4, 8]))
    return np.kron(rng.uniform(size=(n, n)), np.ones((SIZE // n, SIZE // n)))


PATTERNS = (_checker, _stripes, _bricks, _dots, _print, _marble, _tiles, fractal)


def surface(rng: np.random.Generator, detail: float = 0.7) -> np.ndarray:
    """A random reflectance texture in [0.02, 0.92]; with probability 1 − `detail` a plain colour."""
    if rng.uniform() > detail:
        return plain(colour(rng))
    mask = PATTERNS[rng.integers(len(PATTERNS))](rng)[..., None]
    image = colour(rng) * (1 - mask) + colour(rng) * mask
    if rng.uniform() < 0.4:
        image = image * (0.6 + 0.4 * fractal(rng, 8)[..., None])
    return np.clip(image, 0.02, 0.92).astype(np.float32)


def poster(rng: np.random.Generator) -> np.ndarray:
    """A picture: a gradient, overlapping ellipses and bars of flat colour, a few lines of print; not periodic."""
    y, x = (np.mgrid[:SIZE, :SIZE] + 0.5) / SIZE
    image = colour(rng) * y[..., None] + colour(rng) * (1 - y[..., None])
    for _ in range(int(rng.integers(3, 12))):
        (u, v), (a, b) = rng.uniform(0, 1, 2), rng.uniform(0.04, 0.35, 2)
        round_ = ((x - u) / a) ** 2 + ((y - v) / b) ** 2 < 1
        inside = round_ if rng.uniform() < 0.6 else (abs(x - u) < a) & (abs(y - v) < b)
        image = np.where(inside[..., None], colour(rng), image)
    if rng.uniform() < 0.6:
        top = int(rng.integers(0, SIZE // 2))
        lines = _print(rng)[: SIZE // 3, :, None]
        part = image[top : top + SIZE // 3]
        image[top : top + SIZE // 3] = part * (1 - lines) + colour(rng) * lines
    return np.clip(image, 0.02, 0.92).astype(np.float32)


def sky(rng: np.random.Generator, sun: bool) -> np.ndarray:
    """A latitude-longitude radiance map: gradient from zenith to horizon, ground below, and maybe a wide soft sun.

    The sun is degrees wide, not half a degree: shadows stay soft and one-sample images free of extreme fireflies.
    """
    height, width = SKY
    up = np.cos((np.arange(height) + 0.5) / height * np.pi)[:, None, None]
    zenith, horizon, ground = colour(rng, 0.2, 1.0), colour(rng, 0.4, 1.2), colour(rng, 0.05, 0.4)
    image = np.where(up > 0, horizon + (zenith - horizon) * np.clip(up, 0, 1) ** 0.5, ground) * np.ones((1, width, 1))
    if sun:
        theta, phi = np.arccos(up[..., 0]), (np.arange(width) + 0.5)[None] / width * 2 * np.pi
        at, around = np.arccos(rng.uniform(0.25, 0.9)), rng.uniform(0, 2 * np.pi)
        cosine = np.cos(theta) * np.cos(at) + np.sin(theta) * np.sin(at) * np.cos(phi - around)
        lobe = np.exp(rng.uniform(60, 250) * (cosine - 1))[..., None]
        weight = np.sin(theta)[..., None]
        strength = rng.uniform(0.5, 4) * (image * weight).sum() / ((lobe * weight).sum() * 3)
        image = image + lobe * strength * np.array([1.0, rng.uniform(0.8, 1.0), rng.uniform(0.6, 1.0)])
    return image.astype(np.float32)

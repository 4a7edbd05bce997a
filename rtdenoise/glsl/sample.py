"""A small noisy animation without a renderer: what an export is checked with."""

from __future__ import annotations

import numpy as np

from ..frame import Frame

SPEED = 5, 2  # of the disc in pixels a frame, x and y


def sample_frames(size: tuple[int, int], count: int, speed: tuple[float, float] = SPEED) -> list[Frame]:
    """Frames of numpy arrays, size = (H, W): a disc slides over a wall that moves too, under exponential noise, with
    empty sky above. Motion is exact both ways, so some pixels are uncovered in every frame but the first."""
    H, W = size
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:H, :W].astype(np.float32)
    frames = []
    for number in range(count):
        left, top = W / 3 + speed[0] * number, H / 2 + speed[1] * number
        disc = (x - left) ** 2 + (y - top) ** 2 < (min(H, W) / 4) ** 2
        sky = (y < H / 6) & ~disc
        wall = 0.5 + 0.4 * np.sin(0.13 * (x + number)) * np.sin(0.09 * y)
        albedo = np.where(disc, 0.3 + 0.2 * np.cos(0.17 * (x - left)), np.where(sky, 0, wall))
        normal = np.where(disc, [[[0.6]], [[0.0]], [[0.8]]], np.where(sky, 0, [[[0.0]], [[0.0]], [[1.0]]]))
        light = np.where(sky, 1.0, albedo * (0.5 + x / W) * rng.exponential(size=(3, H, W)))
        moves = np.where(disc, np.reshape(speed, (2, 1, 1)), np.reshape((-1, 0), (2, 1, 1)))
        layers = {
            "radiance": light, "albedo": np.broadcast_to(albedo, (3, H, W)), "normal": normal,
            "depth": np.where(disc, 3.0, np.where(sky, 0.0, 8.0))[None], "motion": -moves, "motion_next": moves,
        }  # fmt: skip
        arrays = {name: np.ascontiguousarray(layer[None], np.float32) for name, layer in layers.items()}
        frames.append(Frame(**arrays, number=number, name="sample"))
    return frames

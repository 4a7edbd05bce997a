"""Somebody has a path tracer in numpy: three lines to a clean frame. Prints how much closer to the truth it is."""

import numpy as np

random, size = np.random.default_rng(0), (64, 96)
y, x = np.mgrid[: size[0], : size[1]]
texture = 0.5 + 0.4 * np.sin(x / 5) * np.sin(y / 7)
albedo = np.stack([texture, 0.8 * texture, 0.6 * texture], axis=2)
normal, depth = np.tile([0.0, 0.0, 1.0], (*size, 1)), np.full(size, 4.0)
motion = np.zeros((*size, 2))
truth = 2 * albedo


def render():
    return truth * random.exponential(size=(*size, 1))  # noise like that of one sample a pixel


import rtdenoise  # noqa: E402

denoiser = rtdenoise.Denoiser()
for color in (render() for _ in range(6)):
    clean = denoiser(color, albedo=albedo, normal=normal, depth=depth, motion=motion, motion_next=motion)

error = [float(np.sqrt(np.mean((image - truth) ** 2))) for image in (color, clean)]
assert clean.shape == color.shape and clean.dtype == color.dtype == np.float64
assert error[1] < error[0] / 8, error
print(f"error of a noisy frame {error[0]:.3f}, of the clean one {error[1]:.3f}")

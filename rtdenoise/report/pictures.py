"""Pictures inside a web page: linear radiance with its full range, so that the page can change the exposure.

A picture is three planes of log codes, 64 to a stop (a step of 1.1 %, about one of 8-bit sRGB at white):

    code = round(64 · log2(1 + x / ε)),    ε = 2⁻¹⁰ of display white

first green, then red - green and blue - green, which are near 0 where the picture is grey. A plane is stored as
differences from a prediction from three neighbours, the median edge detector of JPEG-LS:

    p = min(left, up) where upleft ≥ both,    max(left, up) where upleft ≤ both,    left + up - upleft elsewhere

signs in the lowest bit, all low bytes before all high bytes, deflated, in base64. assets/picture.js is the inverse.
"""

from __future__ import annotations

import base64
import zlib

import numpy as np

STEPS = 64  # codes a stop
EPSILON = 2.0**-10  # of display white
MAX_RADIANCE = 2.0**12  # of display white; brighter pixels are clipped
MAX_LEVEL = 63  # code of 1 in a map


def encode_picture(image: np.ndarray, exposure: float) -> str:
    """`[H, W, 3]` linear radiance, to be shown at `exposure`."""
    x = np.clip(np.nan_to_num(image, nan=0.0, posinf=MAX_RADIANCE) * exposure, 0, MAX_RADIANCE)
    codes = np.rint(STEPS * np.log2(1 + x / EPSILON)).astype(np.int32)
    red, green, blue = (codes[..., c] for c in range(3))
    return pack(b"".join(_plane(plane) for plane in (green, red - green, blue - green)))


def encode_map(values: np.ndarray) -> str:
    """`[H, W]` in [0, 1], in 64 levels: a FLIP map, a mask. NaN is 1, the greatest error."""
    return pack(_plane(np.rint(np.clip(np.nan_to_num(values, nan=1.0), 0, 1) * MAX_LEVEL).astype(np.int32)))


def encode_motion(motion: np.ndarray) -> str:
    """`[H, W, 2]` in pixels, in quarters of a pixel; clipped at ±2047. NaN is 0."""
    quarters = np.rint(np.clip(np.nan_to_num(motion, nan=0.0), -2047.75, 2047.75) * 4).astype(np.int32)
    return pack(b"".join(_plane(quarters[..., c]) for c in range(2)))


def _plane(plane: np.ndarray) -> bytes:
    left, up, upleft = np.zeros_like(plane), np.zeros_like(plane), np.zeros_like(plane)
    left[:, 1:], up[1:], upleft[1:, 1:] = plane[:, :-1], plane[:-1], plane[:-1, :-1]
    least, most = np.minimum(left, up), np.maximum(left, up)
    predicted = np.where(upleft >= most, least, np.where(upleft <= least, most, left + up - upleft))
    difference = plane - predicted
    folded = ((difference << 1) ^ (difference >> 31)).astype(np.uint16)
    return (folded & 255).astype(np.uint8).tobytes() + (folded >> 8).astype(np.uint8).tobytes()


def pack(data: bytes) -> str:
    """Compressed, as text."""
    return base64.b64encode(zlib.compress(data, 9)).decode()

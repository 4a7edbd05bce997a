"""The test for one surface."""

from __future__ import annotations

import triton
import triton.language as tl


@triton.jit
def surface_at(depth, normal, plane, at, exists):
    """Depth and normal (x, y, z) of the pixels `at` of one image."""
    d = tl.load(depth + at, mask=exists, other=0.0)
    x = tl.load(normal + at, mask=exists, other=0.0)
    y = tl.load(normal + plane + at, mask=exists, other=0.0)
    z = tl.load(normal + 2 * plane + at, mask=exists, other=0.0)
    return d, x, y, z


@triton.jit
def alike(d, x, y, z, other_d, other_x, other_y, other_z, depth_tolerance, normal_tolerance):
    """`ops.alike` of two surfaces."""
    length = tl.sqrt((x * x + y * y + z * z) * (other_x * other_x + other_y * other_y + other_z * other_z))
    near = tl.abs(d - other_d) <= depth_tolerance * tl.maximum(d, other_d)
    aligned = x * other_x + y * other_y + z * other_z >= normal_tolerance * length
    hit, other_hit = d > 0, other_d > 0
    return (hit & other_hit & near & aligned) | (~hit & ~other_hit)

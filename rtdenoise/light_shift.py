"""How far light has moved over its surface: behind glass, or in a mirror.

A renderer writes the motion of the surface that a pixel hits. What is seen through a pane moves otherwise, a window's
bars by half a pixel a frame; after four frames history would show them beside where they are. Most light of few samples
a pixel is too noisy to be followed. That of bright panes, lamps and skies has no noise at all: around it the shift is
found by least squares (Lucas and Kanade, An Iterative Image Registration Technique, 1981).
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from .color import luminance
from .constants import DEPTH_TOLERANCE
from .motion import on_screen
from .ops import warp
from .ops.block_luminance import block_luminance

BLOCK = 3  # side in pixels of the blocks that are even or not
EVEN = 4e-3  # an even block's greatest luminance over its mean, less 1; half floats round by an eighth of that
CONTRAST = 1.5  # greatest luminance around an even block over the least one, from which there is an edge
AROUND = 3  # blocks from an even one, up to which its surface shifts with it
CELL = 32  # side in pixels of the cells that shift as one; 3 × 3 of them are fitted together
ENOUGH = 64  # pixels of a fit, at least
ROUNDS = 2  # of least squares
DAMPING = 0.03  # share of the mean square that is added to it
LIGHT = 8.0  # light of a frame's mean becomes log(1 + LIGHT)
LEAST, GREATEST = 0.2, 1.2  # pixels: shorter shifts are noise, longer ones mistakes


@torch.no_grad()
def light_shift(
    noisy: Tensor,  # [B, 3, H, W] radiance of the frame
    noisy_before: Tensor,  # [B, 3, H, W] of the frame before
    motion: Tensor,  # [B, 2, H, W] (x, y) in pixels, to the frame before
    depth: Tensor,  # [B, 1, H, W]
    depth_before: Tensor,  # [B, 1, H, W]
) -> Tensor | None:  # [B, 2, H, W] pixels that belong to motion, too; None: light moves with its surfaces
    """The shift d, that minimises Σ (y(p) - y'(p + motion(p) + d))² over the pixels p around, of compressed and blurred
    luminance y and that of the frame before, y'. A pixel counts where it lies in or beside an even block of its
    surface, now and then, and where it led there. On a CPU there is nothing to do where no edge lies beside even light;
    on a GPU, looking would mean waiting."""
    H, W = depth.shape[2:]
    near, edges = _even(noisy, depth)
    if noisy.device.type == "cpu" and not edges.any():
        return None
    near_before, _ = _even(noisy_before, depth_before)
    scale = LIGHT / luminance(noisy).mean((1, 2, 3), keepdim=True).clamp(min=1e-12)
    light, light_before = (_blurred((1 + scale * luminance(x)).log()) for x in (noisy, noisy_before))
    there = torch.cat([light_before, *_slopes(light_before), _pixels(near_before, H, W), depth_before], dim=1)
    here, shift, outside = _pixels(near, H, W), torch.zeros_like(motion), torch.zeros_like(there)
    for _ in range(ROUNDS):
        value, x, y, then, far = warp(there, motion + shift, on_screen(motion + shift), outside).split(1, dim=1)
        weight = here * (then > 0.5) * ((depth - far).abs() <= DEPTH_TOLERANCE * torch.maximum(depth, far))
        apart = light - value
        terms = [one * other for one, other in ((x, x), (x, y), (y, y), (x, apart), (y, apart))]
        shift = shift + _solved(torch.cat([weight, *(weight * term for term in terms)], dim=1), H, W)
    length = shift.norm(dim=1, keepdim=True)
    return shift * ((length > LEAST) & (length < GREATEST) & _around(near, depth))


def _even(noisy: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
    """Blocks `[B, 1, ⌈H/3⌉, ⌈W/3⌉]` in and beside which light is even on one surface: 1. And those of them with an edge
    of light."""
    size = [-(-n // BLOCK) for n in depth.shape[2:]]
    mean, greatest = (x.unflatten(1, (1, *size)) for x in block_luminance(noisy, BLOCK))
    near = _greatest(((greatest <= (1 + EVEN) * mean) & (mean > 0)).to(noisy.dtype))
    if noisy.device.type == "cpu" and not near.any():
        return near, near
    farthest, nearest = (_greatest(F.max_pool2d(x, BLOCK, ceil_mode=True)) for x in (depth, -depth))
    near = near * (farthest + nearest <= DEPTH_TOLERANCE * farthest)
    return near, near * (_greatest(greatest) > -CONTRAST * _greatest(-mean))


def _around(near: Tensor, depth: Tensor) -> Tensor:
    """The pixels on the surfaces of the blocks `near` and `AROUND` them, `[B, 1, H, W]` bool."""
    H, W = depth.shape[2:]
    far = F.max_pool2d(depth, BLOCK, ceil_mode=True)
    farthest, nearest = (_pixels(_greatest(torch.where(near > 0, x, -torch.inf), AROUND), H, W) for x in (far, -far))
    return (depth <= (1 + DEPTH_TOLERANCE) * farthest) & (depth >= (DEPTH_TOLERANCE - 1) * nearest)


def _solved(terms: Tensor, H: int, W: int) -> Tensor:
    """The damped solution in each cell, `[B, 2, H, W]`, linear between cells, from the weight and its products."""
    padded = F.pad(terms, (0, -W % CELL, 0, -H % CELL))
    sums = F.avg_pool2d(F.avg_pool2d(padded, CELL), 3, stride=1, padding=1) * (9 * CELL**2)
    count, xx, xy, yy, x, y = sums.split(1, dim=1)
    damping = DAMPING * count + 1e-6
    xx, yy = xx + damping, yy + damping
    solution = torch.cat([yy * x - xy * y, xx * y - xy * x], dim=1) / (xx * yy - xy * xy) * (count > ENOUGH)
    return F.interpolate(solution, scale_factor=CELL, mode="bilinear", align_corners=False)[..., :H, :W]


def _greatest(blocks: Tensor, around: int = 1) -> Tensor:
    return F.max_pool2d(blocks, 2 * around + 1, stride=1, padding=around)


def _pixels(blocks: Tensor, H: int, W: int) -> Tensor:
    return F.interpolate(blocks, scale_factor=BLOCK, mode="nearest")[..., :H, :W]


def _blurred(x: Tensor) -> Tensor:
    return F.avg_pool2d(F.pad(x, (1, 1, 1, 1), mode="replicate"), 3, stride=1)


def _slopes(x: Tensor) -> tuple[Tensor, Tensor]:
    """∂/∂x and ∂/∂y."""
    x = F.pad(x, (1, 1, 1, 1), mode="replicate")
    return (x[..., 1:-1, 2:] - x[..., 1:-1, :-2]) / 2, (x[..., 2:, 1:-1] - x[..., :-2, 1:-1]) / 2

"""How far light has moved over its surface: behind glass, or in a mirror.

A renderer writes the motion of the surface that a pixel hits. What is seen through a pane moves otherwise, a window's
bars by half a pixel a frame; after four frames history would show them beside where they are. Most light of few samples
a pixel is too noisy to be followed. That of bright panes, lamps and skies has no noise at all: around it the shift is
found by least squares (`displacement`).
"""

from __future__ import annotations

from functools import reduce

import torch
from torch import Tensor
from torch.nn import functional as F

from ..constants import (
    DEPTH_TOLERANCE,
    SHIFT_BESIDE,
    SHIFT_BLOCK,
    SHIFT_CONTRAST,
    SHIFT_EVEN,
    SHIFT_GREATEST,
    SHIFT_LEAST,
    SHIFT_LIGHT_CELL,
    SHIFT_LIGHT_DAMPING,
)
from ..ops.block_luminance import block_luminance
from ..ops.dispatch import Fused, Support, falls_back
from .displacement import compressed, displacement, spread

LAYERS = dict.fromkeys(("noisy", "before"), (3,)) | {"motion": (2,)} | dict.fromkeys(("depth", "was"), (1,))
FUSED = Fused("light_shift", triton=Support(channels=LAYERS))
SURFACE = Fused("light_shift.one_surface", triton=Support(channels={"depth": (1,)}))


@torch.no_grad()
@falls_back
def light_shift(
    noisy: Tensor,  # [B, 3, H, W] radiance of the frame
    noisy_before: Tensor,  # [B, 3, H, W] of the frame before
    motion: Tensor,  # [B, 2, H, W] (x, y) in pixels, to the frame before
    depth: Tensor,  # [B, 1, H, W]
    depth_before: Tensor,  # [B, 1, H, W]
) -> Tensor | None:  # [B, 2, H, W] pixels that belong to motion, too; None: light moves with its surfaces
    """The shift d, that minimises Σ (y(p) - y'(p + motion(p) + d))² over the pixels p around, of compressed and blurred
    luminance y and that of the frame before, y'. A pixel counts where it lies in or beside an even block of its
    surface. On a CPU there is nothing to do where no edge lies beside even light, or none has moved; on a GPU, looking
    would mean waiting."""
    if run := FUSED(noisy=noisy, before=noisy_before, motion=motion, depth=depth, was=depth_before):
        return run(noisy, noisy_before, motion, depth, depth_before)
    H, W = depth.shape[2:]
    near, edges = _even(noisy, depth)
    if noisy.device.type == "cpu" and not edges.any():
        return None
    light, light_before = compressed(noisy, noisy_before, blurred=True)
    shift, _ = displacement(
        light, light_before, motion, _pixels(near, H, W), depth, depth_before,
        cell=SHIFT_LIGHT_CELL, damping=SHIFT_LIGHT_DAMPING,
    )  # fmt: skip
    if noisy.device.type == "cpu" and not (_squared(shift) > SHIFT_LEAST**2).any():
        return None
    shift = spread(shift, SHIFT_LIGHT_CELL, H, W)
    squared = _squared(shift)
    return shift.mul_((squared > SHIFT_LEAST**2) & (squared < SHIFT_GREATEST**2) & _around(near, depth))


def _even(noisy: Tensor, depth: Tensor) -> tuple[Tensor, Tensor]:
    """Blocks `[B, 1, ⌈H/3⌉, ⌈W/3⌉]` in and beside which light is even on one surface: 1. And those of them with an edge
    of light."""
    size = [-(-n // SHIFT_BLOCK) for n in depth.shape[2:]]
    mean, greatest = (x.unflatten(1, (1, *size)) for x in block_luminance(noisy, SHIFT_BLOCK))
    near = _greatest(((greatest <= (1 + SHIFT_EVEN) * mean) & (mean > 0)).to(noisy.dtype))
    if noisy.device.type == "cpu" and not near.any():
        return near, near
    near = near * _flat(depth)
    return near, near * (_greatest(greatest) > -SHIFT_CONTRAST * _greatest(-mean))


@falls_back
def one_surface(depth: Tensor) -> Tensor:
    """The pixels around which depth is that of one surface, 1, of `[B, 1, H, W]`; 0 elsewhere."""
    if run := SURFACE(depth=depth):
        return run(depth)
    return _pixels(_flat(depth), *depth.shape[2:])


def _flat(depth: Tensor) -> Tensor:
    """Blocks in and beside which depth is that of one surface: 1."""
    farthest, nearest = (_greatest(_blocks(x)) for x in (depth, -depth))
    return (farthest + nearest <= DEPTH_TOLERANCE * farthest).to(depth.dtype)


def _around(near: Tensor, depth: Tensor) -> Tensor:
    """The pixels on the surfaces of the blocks `near` and `SHIFT_BESIDE` them, `[B, 1, H, W]` bool."""
    H, W = depth.shape[2:]
    far = _blocks(depth)
    its = (_greatest(torch.where(near > 0, x, -torch.inf), SHIFT_BESIDE) for x in (far, -far))
    farthest, nearest = (_pixels(x, H, W) for x in its)
    return (depth <= (1 + DEPTH_TOLERANCE) * farthest) & (depth >= (DEPTH_TOLERANCE - 1) * nearest)


def _greatest(blocks: Tensor, around: int = 1) -> Tensor:
    """The greatest value of each block and those around it, as `F.max_pool2d`, which takes ten times as long on a CPU;
    so do the pools that the next two stand for."""
    (H, W), sides = blocks.shape[2:], range(2 * around + 1)
    rows = F.pad(blocks, (0, 0, around, around), value=-torch.inf)
    blocks = reduce(torch.maximum, [rows[:, :, i : i + H] for i in sides])
    columns = F.pad(blocks, (around, around, 0, 0), value=-torch.inf)
    return reduce(torch.maximum, [columns[..., i : i + W] for i in sides])


def _blocks(x: Tensor) -> Tensor:
    """The greatest value of each block, `[B, 1, ⌈H/3⌉, ⌈W/3⌉]`."""
    H, W = x.shape[2:]
    x = F.pad(x, (0, -W % SHIFT_BLOCK, 0, -H % SHIFT_BLOCK), value=-torch.inf)
    x = reduce(torch.maximum, [x[:, :, i::SHIFT_BLOCK] for i in range(SHIFT_BLOCK)])
    return reduce(torch.maximum, [x[..., i::SHIFT_BLOCK] for i in range(SHIFT_BLOCK)])


def _squared(shift: Tensor) -> Tensor:
    """Its length squared, `[B, 1, H, W]`: `norm` over channels is many times slower on a CPU."""
    return shift[:, :1].square().add_(shift[:, 1:].square())


def _pixels(blocks: Tensor, H: int, W: int) -> Tensor:
    return F.interpolate(blocks, scale_factor=SHIFT_BLOCK, mode="nearest")[..., :H, :W]

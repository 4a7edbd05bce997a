"""Targets of motion vectors: shared by `warp`, `fetch`, `reproject` and `unlike`."""

from __future__ import annotations

import torch
from torch import Tensor


def clamped_targets(motion: Tensor, H: int, W: int) -> tuple[Tensor, Tensor]:
    """Target coordinates u, v `[B, H, W]` of `motion` `[B, 2, H, W]`, clamped to the image; pixel (0, 0) is at 0. A
    motion that is not finite counts as zero."""
    motion = motion.to(torch.promote_types(motion.dtype, torch.float32))  # half floats do not number 3000 columns
    motion = torch.nan_to_num(motion, nan=0.0, posinf=0.0, neginf=0.0)
    x = torch.arange(W, device=motion.device, dtype=motion.dtype)
    y = torch.arange(H, device=motion.device, dtype=motion.dtype)
    return (motion[:, 0] + x).clamp(0, W - 1), (motion[:, 1] + y[:, None]).clamp(0, H - 1)


def on_screen(motion: Tensor) -> Tensor:
    """Whether p + motion(p) lies on the image, `[B, 1, H, W]` bool. False for a motion that is not finite."""
    _, _, H, W = motion.shape
    motion = motion.to(torch.promote_types(motion.dtype, torch.float32))  # as above
    u = motion[:, 0:1] + torch.arange(W, device=motion.device, dtype=motion.dtype)
    v = motion[:, 1:2] + torch.arange(H, device=motion.device, dtype=motion.dtype)[:, None]
    return (u >= -0.5) & (u <= W - 0.5) & (v >= -0.5) & (v <= H - 0.5)


def check(image: Tensor, motion: Tensor, **others: tuple[Tensor, int]) -> None:
    """Raise ValueError unless `motion` is `[B, 2, H, W]` for an image `[B, C, H, W]`, and each of `others`, a tensor
    and its channels, `[B, channels, H, W]`."""
    if image.ndim != 4:
        raise ValueError(f"expected image [B, C, H, W], got {tuple(image.shape)}")
    for name, (tensor, channels) in {"motion": (motion, 2), **others}.items():
        expected = (image.shape[0], channels, *image.shape[2:])
        if tuple(tensor.shape) != expected:
            raise ValueError(f"expected {name} {expected} for an image {tuple(image.shape)}, got {tuple(tensor.shape)}")

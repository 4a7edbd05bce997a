"""Dual motion vectors, occlusion masks and history validity (the paper, §3.2 and §4.4)."""

from __future__ import annotations

import torch
from torch import Tensor

from .constants import DEPTH_TOLERANCE, MIN_NORMAL_COSINE
from .frame import OCCLUSION_THRESHOLD, Frame
from .ops import alike, fetch
from .ops.targets import on_screen as on_screen


def dual_motion(
    motion: Tensor,  # [B, 2, H, W] previous - current
    motion_next_previous: Tensor,  # [B, 2, H, W] next - current, of the previous frame
) -> Tensor:  # [B, 2, H, W]
    """Motion that leads an uncovered pixel to background instead of to its occluder (eq. 2; Zeng et al. 2021).

    The surface at x was at y = x + motion(x). If it was hidden there, y held the occluder, which has since moved to
    z = y + motion_next_previous(y). The background that is now as far from the occluder as x is from z was at y + (x -
    z), so

        dual(x) = y + (x - z) - x = -motion_next_previous(x + motion(x)),        fetched at the nearest pixel

    and where nothing was hidden z = x and dual = motion. A target off the screen has no occluder: there dual = motion.
    """
    return torch.where(on_screen(motion), -fetch(motion_next_previous, motion), motion)


def occlusion_mask(dual: Tensor, motion: Tensor, threshold: float = OCCLUSION_THRESHOLD) -> Tensor:
    """M of eq. 5: True where a moving object has just uncovered the pixel, `[B, 1, H, W]` bool: ‖dual - motion‖ >
    threshold."""
    return (dual - motion).square().sum(1, keepdim=True) > threshold**2


def uncovered(frame: Frame, motion_next_previous: Tensor | None) -> Tensor:
    """`occlusion_mask` of a frame by `motion_next` of the frame before; empty if that is None."""
    if motion_next_previous is None:
        return torch.zeros_like(frame.radiance[:, :1], dtype=torch.bool)
    return occlusion_mask(dual_motion(frame.motion, motion_next_previous), frame.motion)


def occlusion_weights(masks: list[Tensor]) -> Tensor:
    """Σ_k w_k M_{i-k} of eq. 5 with w = 1, 0.8, 0.6; `masks` = [M_i, M_{i-1}, M_{i-2}], missing ones taken as M_i."""
    padded = (masks + [masks[0]] * 3)[:3]
    return sum(w * m.to(torch.float32) for w, m in zip((1.0, 0.8, 0.6), padded, strict=True))


def same_surface(
    depth: Tensor,  # [B, 1, H, W] of the current frame
    normal: Tensor,  # [B, 3, H, W]
    depth_previous: Tensor,  # [B, 1, H, W] of the previous frame, not yet reprojected
    normal_previous: Tensor,  # [B, 3, H, W]
    motion: Tensor,  # [B, 2, H, W] the motion that history is fetched with
    depth_tolerance: float = DEPTH_TOLERANCE,
    normal_tolerance: float = MIN_NORMAL_COSINE,
) -> Tensor:  # [B, 1, H, W] bool
    """Whether history was fetched from a surface like the one that is here now (the geometric part of history
    validity): `ops.alike`, both looked up at the nearest pixel."""
    before = fetch(depth_previous, motion), fetch(normal_previous, motion)
    return alike((depth, normal), before, depth_tolerance, normal_tolerance)

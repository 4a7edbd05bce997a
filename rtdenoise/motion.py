"""Dual motion vectors, where they come from, occlusion masks and history validity (the paper, §3.2 and §4.4)."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from .frame import OCCLUSION_THRESHOLD, OFF_SCREEN, Frame
from .ops import alike, fetch


def dual_motion(
    motion: Tensor,  # [B, 2, H, W] previous - current
    motion_next_previous: Tensor,  # [B, 2, H, W] next - current, of the previous frame
) -> Tensor:  # [B, 2, H, W]
    """Motion that leads an uncovered pixel to background instead of to what covered it (eq. 2; Zeng et al. 2021).

    The surface at x was at y = x + motion(x). If it was hidden there, y held the occluder, which has since moved to
    z = y + motion_next_previous(y). The background that is now as far from the occluder as x is from z was at y + (x -
    z), so

        dual(x) = y + (x - z) - x = -motion_next_previous(x + motion(x)),        fetched at the nearest pixel

    and where nothing was hidden z = x and dual = motion. A target off the screen has no occluder: there dual = motion.
    """
    return torch.where(on_screen(motion), -fetch(motion_next_previous, motion), motion)


def motion_between(
    position: Tensor,  # [B, 3, H, W] world space, at the time of `here`
    id: Tensor,  # [B, 1, H, W] object ids, 0: nothing hit
    here: dict,  # scene.json's entry of the frame that `position` belongs to
    there: dict,  # ... of the frame before or after it
) -> Tensor:  # [B, 2, H, W] pixels, `there` minus `here`
    """Exact screen motion of rigidly moving objects under a moving camera, from the matrices of `scene.json`.

        p' = W_there W_here⁻¹ p,    motion = project_there(p') - project_here(p)

    with W an object's object-to-world matrix (absent: it does not move) and project the frame's world-to-pixel matrix.
    Where nothing was hit the point is at infinity along the pixel's ray, so only the camera's rotation counts. Points
    behind the other frame's camera get `OFF_SCREEN`, and so does every point where the two frames belong to different
    shots (entry "shot", 0 if absent): no history survives a cut. Computed in float64, returned in the dtype of
    `position`.
    """
    B, _, H, W = position.shape
    if here.get("shot", 0) != there.get("shot", 0):
        return position.new_full((B, 2, H, W), OFF_SCREEN)
    to64 = {"dtype": torch.float64, "device": position.device}
    # Rows x·w, y·w and w of world-to-pixel; the row that holds depth plays no part.
    to_here, to_there = (torch.as_tensor(entry["world_to_pixel"], **to64)[[0, 1, 3]] for entry in (here, there))

    v, u = torch.meshgrid(torch.arange(H, **to64) + 0.5, torch.arange(W, **to64) + 0.5, indexing="ij")
    ray = torch.einsum("ij,jhw->ihw", torch.linalg.inv(to_here[:, :3]), torch.stack([u, v, torch.ones_like(u)]))
    surface = torch.cat([position.to(**to64), torch.ones(B, 1, H, W, **to64)], dim=1)  # homogeneous: w = 1
    infinity = torch.cat([ray, torch.zeros(1, H, W, **to64)])  # w = 0
    point = torch.where(id == 0, infinity, surface)

    moved = point
    for key in here["object_to_world"].keys() & there["object_to_world"].keys():
        W_here, W_there = (torch.as_tensor(entry["object_to_world"][key], **to64) for entry in (here, there))
        moved = torch.where(
            id == int(key), torch.einsum("ij,bjhw->bihw", W_there @ torch.linalg.inv(W_here), point), moved
        )

    before, after = torch.einsum("ij,bjhw->bihw", to_here, point), torch.einsum("ij,bjhw->bihw", to_there, moved)
    motion = after[:, :2] / after[:, 2:] - before[:, :2] / before[:, 2:]
    return torch.where(after[:, 2:] > 1e-6, motion, OFF_SCREEN).to(position.dtype)


def motion_from_scene(frame: Frame, scene: dict) -> Frame:
    """The frame with those of `motion` and `motion_next` that it lacks, computed from `position`, `id` and
    `scene.json`.

    `scene` is the parsed scene.json: its `frames` must hold the frame's number and, for each motion, the number before
    or after. What cannot be computed stays None.
    """
    entries = {entry["number"]: entry for entry in scene["frames"]}
    here = entries.get(frame.number)
    if here is None or frame.position is None or frame.id is None:
        return frame
    wanted = {"motion": frame.number - 1, "motion_next": frame.number + 1}
    return replace(frame, **{
        layer: motion_between(frame.position, frame.id, here, entries[number])
        for layer, number in wanted.items()
        if getattr(frame, layer) is None and number in entries
    })  # fmt: skip


def on_screen(motion: Tensor) -> Tensor:
    """Whether p + motion(p) lies on the image, `[B, 1, H, W]` bool. A motion that is not finite does not."""
    _, _, H, W = motion.shape
    u = motion[:, 0:1] + torch.arange(W, device=motion.device, dtype=motion.dtype)
    v = motion[:, 1:2] + torch.arange(H, device=motion.device, dtype=motion.dtype)[:, None]
    return (u >= -0.5) & (u <= W - 0.5) & (v >= -0.5) & (v <= H - 0.5)


def occlusion_mask(dual: Tensor, motion: Tensor, threshold: float = OCCLUSION_THRESHOLD) -> Tensor:
    """M of eq. 5: True where a moving object has just uncovered the pixel, `[B, 1, H, W]` bool: ‖dual - motion‖ >
    threshold."""
    return (dual - motion).square().sum(1, keepdim=True) > threshold**2


def uncovered(frame: Frame, motion_next_previous: Tensor | None) -> Tensor:
    """`occlusion_mask` of a frame by `motion_next` of the one before; nothing is marked where that is None."""
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
    depth_tolerance: float = 0.1,
    normal_tolerance: float = 0.5,
) -> Tensor:  # [B, 1, H, W] bool
    """Whether history was fetched from a surface like the one that is here now (the geometric part of history
    validity): `ops.alike`, both looked up at the nearest pixel."""
    before = fetch(depth_previous, motion), fetch(normal_previous, motion)
    return alike((depth, normal), before, depth_tolerance, normal_tolerance)

"""How far light moved over its surfaces from one denoised picture to the next: in mirrors, behind glass.

Light without noise is followed within the frame that it helps (`light`). Other light of few samples a pixel can be
followed once it has been denoised: a frame too late, so that the next frame takes what this one found, wherever its
surfaces have moved by then. A picture also changes for other reasons. So a shift counts only where it explains much of
the change, or some of it and the frame before had found about the same.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from ..constants import (
    SHIFT_APART,
    SHIFT_DAMPING,
    SHIFT_GREATEST,
    SHIFT_LEAST,
    SHIFT_LEFT,
    SHIFT_SURE,
)
from ..constants import SHIFT_CELL as CELL
from ..frame import History
from ..motion import on_screen
from ..ops import fetch
from ..ops.dispatch import Fused, Support, falls_back
from .displacement import compressed, displacement, spread
from .light import one_surface

LAYERS = dict.fromkeys(("picture", "radiance"), (3,)) | {"motion": (2,)} | dict.fromkeys(("depth", "was"), (1,))
FIND = Fused("picture.find", triton=Support(other=("found",), channels=LAYERS))
MOVED = Fused("picture.moved", triton=Support(other=("shift",), channels=LAYERS))


@torch.no_grad()
@falls_back
def find(
    picture: Tensor,  # [B, 3, H, W] the denoised frame
    motion: Tensor,  # [B, 2, H, W] (x, y) in pixels, to the frame before
    depth: Tensor,  # [B, 1, H, W]
    history: History,  # of the frame before
) -> tuple[Tensor, Tensor]:
    """The shifts of cells, `[B, 2, ⌈H/CELL⌉, ⌈W/CELL⌉]` pixels each, in this frame: those that explain how the picture
    has changed, 0 elsewhere; and what the next frame takes: those that agree with `history.found`, their mean with it
    (a picture that has caught up with its light has moved by more than that), and those that are sure."""
    layers = {"motion": motion, "depth": depth, "radiance": history.radiance, "was": history.depth}
    fits = history.found is None or history.found.shape == _cells(depth)
    if fits and (run := FIND(picture=picture, **layers, found=history.found)):
        return run(picture, *layers.values(), history.found)
    now, before = compressed(picture, history.radiance)
    shift, left = displacement(
        now, before, motion, one_surface(depth), depth, history.depth,
        cell=CELL, damping=SHIFT_DAMPING,
    )  # fmt: skip
    length = shift.norm(dim=1, keepdim=True)
    found = shift * ((left < SHIFT_LEFT) & (length > SHIFT_LEAST) & (length < SHIFT_GREATEST))
    if history.found is None:
        return found, found * (left < SHIFT_SURE)
    middles = motion[..., CELL // 2 :: CELL, CELL // 2 :: CELL]
    middles = F.pad(middles, (0, found.shape[3] - middles.shape[3], 0, found.shape[2] - middles.shape[2]))
    expected = fetch(history.found, middles / CELL)
    agrees = (found - expected).norm(dim=1, keepdim=True) <= SHIFT_APART * length
    return found, torch.where(agrees, (found + expected) / 2, found * (left < SHIFT_SURE))


@torch.no_grad()
@falls_back
def moved(
    shift: Tensor,  # [B, 2, ⌈H/CELL⌉, ⌈W/CELL⌉] that agreed in the frame before
    motion: Tensor,  # [B, 2, H, W]
    depth: Tensor,  # [B, 1, H, W]
) -> Tensor | None:  # [B, 2, H, W] pixels that belong to motion; None: none do
    """The shift of each pixel of a frame. On a GPU looking whether there is any would mean waiting."""
    if shift.shape == _cells(depth) and (run := MOVED(depth=depth, motion=motion, shift=shift)):
        return run(shift, motion, depth)
    if depth.device.type == "cpu" and not shift.any():
        return None
    H, W = depth.shape[2:]
    there = F.interpolate(shift.ne(0).any(1, keepdim=True).to(shift), scale_factor=CELL, mode="nearest")[..., :H, :W]
    return fetch(spread(shift, CELL, H, W) * there, motion) * (on_screen(motion) & (one_surface(depth) > 0))


def _cells(depth: Tensor) -> tuple[int, ...]:
    """The shape of the shifts of cells of a picture."""
    B, _, H, W = depth.shape
    return B, 2, -(-H // CELL), -(-W // CELL)

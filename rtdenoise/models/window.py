"""What combiners take and return: windows of noisy frames and their estimates, aligned to the current frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional as F

from ..exposure import exposure
from ..frame import OFF_SCREEN, Frame
from ..motion import on_screen
from ..ops import fetch, reproject
from ..sanitise import BRIGHTEST, sanitise

DARK = 0.05  # of the brightness of a frame: darker pixels correct by absolute residuals


@dataclass(frozen=True)
class Window:
    """Consecutive frames, noisy and denoised; None where there is no frame, or one of another shot."""

    frames: tuple[Frame | None, ...]  # radiance y, features, motion, motion_next
    estimates: tuple[Tensor | None, ...]  # z of each frame, [B, 3, H, W]
    halves: tuple[Tensor | None, ...] = ()  # the mean of one half of each y's samples, [B, 3, H, W]; or none at all

    def to(self, device: str | torch.device) -> Window:
        """Moved to a device."""
        frames = tuple(frame and frame.to(device) for frame in self.frames)
        estimates, halves = (
            tuple(None if x is None else x.to(device) for x in part) for part in (self.estimates, self.halves)
        )
        return Window(frames, estimates, halves)


@dataclass(frozen=True)
class Combined:
    """A corrected frame."""

    image: Tensor  # [B, 3, H, W] linear radiance
    confidence: Tensor  # [B, 1, H, W] size of the correction, |image - z|, mean over the channels


def changed(image: Tensor, estimate: Tensor) -> Tensor:
    """`Combined.confidence` of a corrected z; 0 where z is not finite."""
    return (image - estimate.where(estimate.isfinite(), image)).abs().mean(1, keepdim=True)


@dataclass(frozen=True)
class Aligned:
    """A frame of the window, reprojected to the current one; zero where it shows another surface there."""

    residual: Tensor  # [B, 3, H, W] (y - z) / d, see `divisor_of`
    estimate: Tensor  # [B, 3, H, W] z
    valid: Tensor  # [B, 1, H, W] in {0, 1}
    divisor: Tensor  # d: [B, 3, H, W], or [B, 1, 1, 1] of absolute residuals

    @property
    def noisy(self) -> Tensor:
        """y, `[B, 3, H, W]`."""
        return self.estimate + self.divisor * self.residual


def current_of(window: Window, place: int, frames: int) -> tuple[Frame, Tensor]:
    """The frame at `place` with valid features, and its z. Raises ValueError unless the window has `frames` frames,
    that one is there, and each has an estimate of its size."""
    if not len(window.frames) == len(window.estimates) == frames or window.frames[place] is None:
        raise ValueError(f"expected a window of {frames} frames with frame {place}, got {len(window.frames)} frames")
    for frame, estimate in zip(window.frames, window.estimates, strict=True):
        shape = getattr(estimate, "shape", None)
        if frame is not None and not (isinstance(estimate, Tensor) and shape == frame.radiance.shape):
            got = type(estimate).__name__ if shape is None else tuple(shape)
            raise ValueError(f"expected a tensor {tuple(frame.radiance.shape)} as the estimate of a frame, got {got}")
    return with_features(window.frames[place]), window.estimates[place]


def aligned(window: Window, current: int, *, relative: bool = True) -> tuple[list[Aligned | None], Tensor]:
    """Every frame of the window as the one at place `current` sees it, None where it is missing or no motion leads
    there; and the exposure of that one's z, `[B, 1, 1, 1]`.

    Residuals and z are fetched with the same taps, which test that they show the same surface (`ops.reproject`).
    Residuals that are not `relative` are at that exposure.
    """
    frame = with_features(window.frames[current])
    noisy, estimate = comparable(frame.radiance, window.estimates[current])
    scale = exposure(estimate)

    def divisor(estimate: Tensor) -> Tensor:
        return divisor_of(estimate, scale) if relative else 1 / scale

    found: list[Aligned | None] = [None] * len(window.frames)
    own = divisor(estimate)
    found[current] = Aligned((noisy - estimate) / own, estimate, torch.ones_like(frame.depth), own)
    for direction in (-1, 1):
        motion, layer = None, "motion" if direction < 0 else "motion_next"
        place, before = current + direction, frame
        while 0 <= place < len(window.frames) and window.frames[place] is not None:
            onward = getattr(before, layer)
            if onward is None:
                break
            motion = onward if motion is None else two_step(motion, onward)
            there = with_features(window.frames[place])
            surfaces = (frame.depth, frame.normal), (there.depth, there.normal)
            noisy, estimate = comparable(there.radiance, window.estimates[place])
            both, valid = reproject(((noisy - estimate) / divisor(estimate), estimate), motion, *surfaces)
            residual, estimate = both.split(3, dim=1)
            found[place] = Aligned(residual, estimate, valid.to(both.dtype), divisor(estimate))
            place, before = place + direction, there
    return found, scale


def divisor_of(
    estimate: Tensor,  # [B, 3, H, W] z, not negative
    scale: Tensor,  # [B, 1, 1, 1] exposure of the current frame's z
) -> Tensor:  # [B, 3, H, W], above 0
    """What relative residuals (y - z) / d are relative to: d = z + `DARK` times the brightness of the frame.

    Neighbours in space and time share the relative error of z rather than the absolute one: across a texture, the edge
    of a lamp, a highlight. Albedo as the divisor is noise at few samples, and does not know lamps and highlights
    (docs/notes/relative_residuals.md).
    """
    return estimate + DARK / scale


def with_features(frame: Frame) -> Frame:
    """A frame with valid features: missing ones become a white, flat surface's. Radiance stays as it is."""
    nothing = torch.zeros_like(frame.radiance)
    albedo = torch.ones_like(nothing) if frame.albedo is None else frame.albedo
    normal = nothing if frame.normal is None else frame.normal
    depth = torch.ones_like(nothing[:, :1]) if frame.depth is None else frame.depth
    clean = sanitise(replace(frame, radiance=nothing, albedo=albedo, normal=normal, depth=depth))
    return replace(clean, radiance=frame.radiance)


def comparable(noisy: Tensor, estimate: Tensor) -> tuple[Tensor, Tensor]:
    """y and z as the network takes them, `[B, 3, H, W]` each: from 0 to `BRIGHTEST`.

    A pixel that is not finite in one image takes the other's value, so its residual is 0. A firefly in y alone is
    dimmed (`exposure.limit_fireflies`); a firefly in both stays.
    """
    good, known = noisy.isfinite().all(1, keepdim=True), estimate.isfinite().all(1, keepdim=True)
    y, z = (torch.nan_to_num(x, nan=0.0, posinf=0.0, neginf=0.0).clamp(0, BRIGHTEST) for x in (noisy, estimate))
    y, z = torch.where(good, y, z), torch.where(known, z, y)
    dimmed = sanitise(Frame(y)).radiance
    return torch.maximum(dimmed, torch.minimum(y, z)), z


def two_step(
    motion: Tensor,  # [B, 2, H, W] to a neighbour
    onward: Tensor,  # [B, 2, H, W] from the neighbour to the frame after it
) -> Tensor:  # [B, 2, H, W]
    """Motion to the frame after a neighbour: m(p) + onward(p + m(p)), at the nearest pixel; off the screen where either
    leads there."""
    both = motion + fetch(onward, motion)
    return torch.where(on_screen(motion), both, OFF_SCREEN)


def box(image: Tensor, side: int) -> Tensor:
    """Mean over `side` × `side` pixels, of those inside the image."""
    half = side // 2
    rows = F.avg_pool2d(image, (side, 1), stride=1, padding=(half, 0), count_include_pad=False)
    return F.avg_pool2d(rows, (1, side), stride=1, padding=(0, half), count_include_pad=False)

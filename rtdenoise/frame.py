"""The named buffers of one frame, what is carried to the next, and the conventions that all of it obeys.

Conventions (stated here once; every other module refers to this page)
----------------------------------------------------------------------
Images      tensors `[B, C, H, W]`, float32 unless said. Row 0 on top, x right, y down, pixel centres at +0.5.
Radiance    linear, scene-referred, unbounded HDR.
Albedo      in [0, 1]. Normals in world space, in [-1, 1], not half-encoded.
Depth       linear distance from the camera, > 0; 0 (or inf) where nothing was hit.
motion      `[B, 2, H, W]` = (x, y) in pixels, previous minus current: the surface that is at pixel p now was at
            `p + motion(p)` in the previous frame.
motion_next next minus current: the surface that is at p now will be at `p + motion_next(p)` in the next frame.
id          integer per object; 0 where nothing was hit. Stable over a sequence.

A *signal* is what is denoised: `color` (the beauty) or `indirect` (light that bounced at least once on its way).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from .errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

OFF_SCREEN = 1e4  # pixels: the motion of what was nowhere on the other frame, in any direction; half floats hold it
FAR = 1e9  # depth from which on nothing was hit: renderers write inf, FLT_MAX or 1e10 there
CHANNELS = {
    "radiance": 3, "albedo": 3, "normal": 3, "depth": 1, "motion": 2, "motion_next": 2,
    "position": 3, "id": 1, "reference": 3, "reference_half": 3,
}  # fmt: skip


@dataclass(frozen=True)
class Frame:
    """The buffers of one frame. `None` where the sequence does not have the layer.

    Tensors, or numpy arrays of the same shapes for `rtdenoise.glsl`, which does without torch: only the functions below
    import it.

    Only `radiance` is always there. What a denoiser needs and does not find it asks for with `require`.
    """

    radiance: Tensor  # [B, 3, H, W] the noisy signal
    albedo: Tensor | None = None  # [B, 3, H, W]
    normal: Tensor | None = None  # [B, 3, H, W]
    depth: Tensor | None = None  # [B, 1, H, W]
    motion: Tensor | None = None  # [B, 2, H, W] previous - current, pixels
    motion_next: Tensor | None = None  # [B, 2, H, W] next - current, pixels
    position: Tensor | None = None  # [B, 3, H, W] world space
    id: Tensor | None = None  # [B, 1, H, W]
    reference: Tensor | None = None  # [B, 3, H, W] the converged signal, for training and evaluation only
    reference_half: Tensor | None = None  # [B, 3, H, W] the mean of one half of the reference's samples
    number: int = 0  # frame number, as in the file name
    name: str = ""  # where it came from, for messages

    def __post_init__(self) -> None:
        size = (self.radiance.shape[0], *self.radiance.shape[2:])
        for layer, tensor in self.layers():
            expected = (size[0], CHANNELS[layer], *size[1:])
            if tuple(tensor.shape) != expected:
                raise ValueError(f"{self.name or 'frame'}: expected {layer} {expected}, got {tuple(tensor.shape)}")

    @property
    def size(self) -> tuple[int, int]:
        """(H, W)."""
        return self.radiance.shape[2], self.radiance.shape[3]

    def require(self, *layers: str, previous: Tensor | None = None) -> None:
        """Raise InputError where one of `layers` is missing, or `previous` (a history's image) is of another size."""
        for layer in layers:
            if getattr(self, layer) is None:
                raise InputError(f"{self.name or 'frame'}: layer {layer} is missing; needed are {', '.join(layers)}")
        if previous is not None and previous.shape != self.radiance.shape:
            raise InputError(
                f"{self.name or 'frame'}: history is {tuple(previous.shape)}, the frame {tuple(self.radiance.shape)}; "
                "pass history=None to start anew"
            )

    def layers(self) -> list[tuple[str, Tensor]]:
        """(name, tensor) of every buffer that is there."""
        return [(layer, tensor) for layer in CHANNELS if (tensor := getattr(self, layer)) is not None]

    def map(self, function) -> Frame:
        """The same frame with `function` applied to every tensor."""
        return replace(self, **{layer: function(tensor) for layer, tensor in self.layers()})

    def to(self, *args, **kwargs) -> Frame:
        """Moved to a device or dtype, as `Tensor.to`."""
        return self.map(lambda tensor: tensor.to(*args, **kwargs))

    def crop(self, top: int, left: int, height: int, width: int) -> Frame:
        """A window of the frame; motion stays valid because it is relative."""
        return self.map(lambda tensor: tensor[..., top : top + height, left : left + width])


@dataclass(frozen=True)
class History:
    """What one step hands to the next. Passed in and returned, never hidden."""

    radiance: Tensor  # [B, 3, H, W] the denoised previous frame
    motion_next: Tensor | None  # [B, 2, H, W] of the previous frame; None: dual motion next time is approximate
    depth: Tensor | None  # [B, 1, H, W] of the previous frame
    normal: Tensor | None  # [B, 3, H, W] of the previous frame
    length: Tensor | None = None  # [B, 1, H, W] frames accumulated in each pixel; None where nobody counts
    accumulated: Tensor | None = None  # [B, 6, H, W] running means of irradiance and albedo; None: nobody keeps them


def stack(frames: list[Frame]) -> Frame:
    """Frames of the same size and layers as one batch."""
    import torch

    names = [layer for layer, _ in frames[0].layers()]
    return Frame(**{n: torch.cat([getattr(f, n) for f in frames]) for n in names}, number=frames[0].number)


def nearness(depth: Tensor) -> Tensor:
    """Depth `[B, 1, H, W]` as a network sees it, in [0, 1): t / (t + depth) with t the frame's mean distance; 0 where
    nothing was hit."""
    import torch

    hit = depth > 0
    hits = hit.sum((1, 2, 3), keepdim=True).clamp(min=1)
    typical = (depth.sum((1, 2, 3), keepdim=True) / hits).clamp(min=1e-12)
    return torch.where(hit, typical / (typical + depth), 0.0)


def sanitise(frame: Frame) -> Frame:
    """Replace what no filter can use, once, before anything else sees it. Finite, valid frames come back unchanged to
    the bit.

    | layer                 | found                 | becomes |
    |-----------------------|-----------------------|---------|
    | radiance              | NaN, ±Inf or negative | 0       |
    | albedo, normal        | NaN or ±Inf           | 0       |
    | radiance              | above 1e15            | 1e15 (what follows must stay finite in float32) |
    | depth                 | NaN, negative, above 1e9 or Inf | 0 (nothing hit) |
    | motion, motion_next   | NaN or ±Inf           | `OFF_SCREEN`, so no history is taken |

    `non_finite` counts what this will replace.
    """
    import torch

    def clean(tensor: Tensor | None, bad: float, lowest: float | None = None) -> Tensor | None:
        if tensor is None:
            return None
        tensor = torch.where(tensor.isfinite(), tensor, bad)
        return tensor if lowest is None else tensor.clamp(min=lowest)

    return replace(
        frame,
        radiance=clean(frame.radiance, 0.0, lowest=0.0).clamp(max=1e15),
        albedo=clean(frame.albedo, 0.0),
        normal=clean(frame.normal, 0.0),
        depth=None if frame.depth is None else torch.where((frame.depth > 0) & (frame.depth < FAR), frame.depth, 0.0),
        motion=clean(frame.motion, OFF_SCREEN),
        motion_next=clean(frame.motion_next, OFF_SCREEN),
    )


def non_finite(frame: Frame) -> dict[str, int]:
    """Number of pixels per layer that hold NaN or Inf; layers without any are left out."""
    counts = {layer: int((~np.isfinite(np.asarray(tensor))).any(axis=1).sum()) for layer, tensor in frame.layers()}
    return {layer: count for layer, count in counts.items() if count}

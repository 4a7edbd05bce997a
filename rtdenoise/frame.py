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

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

from .errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

OFF_SCREEN = 1e4  # pixels: the motion of what was nowhere on the other frame, in any direction; half floats hold it
# Share of mismatched pixels above which a frame belongs to another shot. Measured by bench/cuts.py: the least threshold
# without a false alarm, and so the one that misses the fewest cuts.
CUT = 0.3
# Pixels by which dual and traditional motion must differ before a pixel counts as uncovered. Where nothing was
# uncovered they differ only because motion_next is fetched at the nearest pixel: by the motion's gradient times half a
# pixel at most. Measured by bench/occlusion_threshold.py: at 0.5, 98 % of what is marked was hidden; less soon marks
# more noise than occlusions, more gains little.
OCCLUSION_THRESHOLD = 0.5
CHANNELS = {
    "radiance": 3, "albedo": 3, "normal": 3, "depth": 1, "motion": 2, "motion_next": 2,
    "position": 3, "id": 1, "reference": 3, "reference_half": 3,
}  # fmt: skip


@dataclass(frozen=True)
class Frame:
    """The buffers of one frame. `None` where the sequence does not have the layer.

    Tensors, or numpy arrays of the same shapes for `rtdenoise.glsl`, which does without torch.

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
    """What one step hands to the next. Passed in and returned, never hidden. Some of it may be the frame's own tensors:
    write into none of them."""

    radiance: Tensor  # [B, 3, H, W] the denoised previous frame
    motion_next: Tensor | None  # [B, 2, H, W] of the previous frame; None: dual motion next time is approximate
    depth: Tensor | None  # [B, 1, H, W] of the previous frame
    normal: Tensor | None  # [B, 3, H, W] of the previous frame
    length: Tensor | None = None  # [B, 1, H, W] frames accumulated in each pixel; None where nobody counts
    mean: Tensor | None = None  # [B, 3, H, W] running mean of irradiance; None where nobody keeps one
    mean_albedo: Tensor | None = None  # [B, 3, H, W] and that of albedo

    def layers(self) -> dict[str, Tensor]:
        """name -> tensor of what there is."""
        return {f.name: tensor for f in fields(self) if (tensor := getattr(self, f.name)) is not None}


@dataclass(frozen=True)
class Known:
    """What is known of a frame beside its buffers, so that a step need not find it out or may leave work out. It must
    be true: nothing checks it. `plan` and `tiles` fill it in."""

    first: bool = False  # there is no history
    still: bool = False  # motion, and motion_next of the frame before, are zero everywhere
    covered: bool = False  # no pixel has been uncovered: `motion.occlusion_mask` is empty
    sanitised: bool = False  # the frame has been through `sanitise`
    exposure: Tensor | None = None  # [B, 1, 1, 1] and
    distance: Tensor | None = None  # [B, 1, 1, 1] of the whole frame that this is a window of: `model.statistics`


NOTHING_KNOWN = Known()


def stack(frames: list[Frame]) -> Frame:
    """Frames of the same size and layers as one batch."""
    import torch

    names = [layer for layer, _ in frames[0].layers()]
    return Frame(**{n: torch.cat([getattr(f, n) for f in frames]) for n in names}, number=frames[0].number)


def mean_distance(depth: Tensor) -> Tensor:
    """Of what was hit, `[B, 1, 1, 1]`; never zero."""
    hits = (depth > 0).sum((1, 2, 3), keepdim=True).clamp(min=1)
    return (depth.sum((1, 2, 3), keepdim=True) / hits).clamp(min=1e-12)

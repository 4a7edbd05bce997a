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
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from .errors import InputError

if TYPE_CHECKING:
    from torch import Tensor

OFF_SCREEN = 1e4  # pixels: the motion of what was nowhere on the other frame, in any direction; half floats hold it
FAR = 1e9  # depth from which on nothing was hit: renderers write inf, FLT_MAX or 1e10 there
BRIGHTEST = 1e15  # radiance; its square is finite in float32
GREATEST_ALBEDO, LONGEST_NORMAL = 16.0, 2.0  # far outside of what is meant, small enough for half precision
FINITE = (-3.4028234663852886e38, 3.4028234663852886e38)
VALID = {  # the least and the greatest value that a layer may hold; `sanitise` mends what lies outside
    "radiance": (0.0, BRIGHTEST), "albedo": (0.0, GREATEST_ALBEDO), "normal": (-LONGEST_NORMAL, LONGEST_NORMAL),
    "depth": (0.0, 999999936.0), "motion": FINITE, "motion_next": FINITE,  # depth: the float32 before FAR
}  # fmt: skip
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


def admit(frame: Frame, previous: Tensor | None, known: Known = NOTHING_KNOWN) -> Frame:
    """The frame as a step that filters along surfaces works on it: sanitised, and with all that is needed.

    `previous` is the image in the history, None without one. Raises InputError where albedo, normal, depth or (with
    history) motion is missing, or the history is of another size.
    """
    frame = frame if known.sanitised else sanitise(frame)
    frame.require("albedo", "normal", "depth", *(() if previous is None else ("motion",)), previous=previous)
    return frame


def sanitise(frame: Frame) -> Frame:
    """Replace what no filter can use, once, before anything else sees it. Valid frames come back unchanged to the bit,
    on a CPU as the tensors that they were.

    | layer               | found                 | becomes |
    |---------------------|-----------------------|---------|
    | radiance            | NaN, ±Inf, negative   | 0       |
    | radiance            | above 1e15            | 1e15 (what follows must stay finite in float32) |
    | radiance            | a firefly             | what `color.limit_fireflies` leaves of it |
    | albedo              | NaN, ±Inf, negative   | 0       |
    | albedo              | above 16              | 16      |
    | normal              | NaN, ±Inf             | 0       |
    | normal              | beyond ±2             | ±2      |
    | depth               | NaN, negative         | 0 (nothing hit) |
    | depth               | above 1e9, Inf        | 0: that is how renderers write a miss, and no fault |
    | motion, motion_next | NaN, ±Inf             | `OFF_SCREEN`, so no history is taken |

    `faults` counts what this will replace. Reference, position and id are left as they are.
    """
    import torch

    from .color import limit_fireflies

    clean = {layer: tensor for layer, tensor in frame.layers() if layer in VALID}
    for layer, tensor in clean.items():
        low, high = VALID[layer]
        if tensor.device.type == "cpu" and _within(tensor, low, high):
            continue  # looking is cheaper than writing; a GPU would have to be waited for
        if layer == "depth":
            clean[layer] = torch.where((tensor > 0) & (tensor < FAR), tensor, 0.0)
        elif layer in ("motion", "motion_next"):
            clean[layer] = torch.nan_to_num(tensor, nan=OFF_SCREEN, posinf=OFF_SCREEN, neginf=OFF_SCREEN)
        else:
            clean[layer] = torch.nan_to_num(tensor, nan=0.0, posinf=0.0, neginf=0.0).clamp_(low, high)
    clean["radiance"] = limit_fireflies(clean["radiance"])
    return replace(frame, **clean)


def _within(tensor: Tensor, low: float, high: float) -> bool:
    """Whether all values are in [low, high]. NaN is not, and makes the least and the greatest NaN."""
    if tensor.numel() == 0:
        return True
    least, greatest = tensor.aminmax()
    return bool((least >= low) & (greatest <= high))


def faults(frame: Frame) -> dict[str, int]:
    """Pixels that `sanitise` will replace, as "layer: what is wrong with it" -> count; what is not there is left out.
    Tensors on the CPU or numpy arrays; fireflies are counted where torch is installed."""
    found: dict[str, np.ndarray] = {}
    for layer, tensor in frame.layers():
        array = np.asarray(tensor)
        finite = np.isfinite(array)
        if layer in ("radiance", "albedo", "normal", "motion", "motion_next"):
            found[f"{layer}: NaN or Inf"] = ~finite
        if layer in ("radiance", "albedo"):
            found[f"{layer}: negative"] = finite & (array < 0)
        if layer == "radiance":
            found["radiance: too bright"] = finite & (array > BRIGHTEST)
            found["radiance: firefly"] = _fireflies(np.where(finite, array, 0).clip(0.0, BRIGHTEST))
        if layer == "albedo":
            found["albedo: too large"] = finite & (array > GREATEST_ALBEDO)
        if layer == "normal":
            found["normal: too long"] = finite & (abs(array) > LONGEST_NORMAL)
        if layer == "depth":
            found["depth: NaN or negative"] = np.isnan(array) | (array < 0)
    counts = {what: int(mask.any(axis=1).sum()) for what, mask in found.items()}
    return {what: count for what, count in counts.items() if count}


def _fireflies(radiance: np.ndarray) -> np.ndarray:
    """Where `color.limit_fireflies` changes it."""
    if find_spec("torch") is None:
        return np.zeros(radiance.shape, bool)
    import torch

    from .color import limit_fireflies

    tensor = torch.from_numpy(radiance)
    return (limit_fireflies(tensor) != tensor).numpy()
